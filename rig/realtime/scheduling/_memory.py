"""Lock the memory of the process during runs, so that no page fault waits for a disk.

Runs at the same time share one lock, which ends with the last of these runs. `_realtime` uses it. It must not unlock
memory that the program had locked before.
"""

import ctypes
import mmap
import re
import sys
import threading
from dataclasses import dataclass

from rig.core.check import Check
from rig.realtime.scheduling import _calls as calls
from rig.realtime.scheduling import refusals
from rig.realtime.scheduling._rights import Rights
from rig.realtime.scheduling.facts import ROOT, status_kilobytes, text_of

assert sys.platform == "linux"

_MAPPING = re.compile(r"^([0-9a-f]+)-([0-9a-f]+) ")


@dataclass(frozen=True, slots=True)
class LockedRange:
    """Range of addresses that was locked in memory before a run, at once or (`on_fault`) each page at its first use."""

    start: int
    end: int
    on_fault: bool


class _Lock:
    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._users = 0
        # None: the program had locked all of its memory itself, so nothing is to be unlocked.
        self._before: list[LockedRange] | None = []

    def take(self) -> Check | None:
        with self._guard:
            if self._users == 0:
                refusal = self._lock()
                if refusal is not None:
                    return refusal
            self._users += 1
            return None

    def give_back(self) -> None:
        with self._guard:
            self._users -= 1
            if self._users == 0 and self._before is not None:
                calls.unlock_all()
                # munlockall takes back the program's own locks too. Ranges that are unmapped by now are refused.
                for pages in self._before:
                    calls.lock_range(pages.start, pages.end - pages.start, on_fault=pages.on_fault)

    def _lock(self) -> Check | None:
        self._before = locked_before()
        if self._before is None:
            return None
        rights = Rights.here()
        # The lock holds for pages to come: at its limit every further allocation of the program would fail.
        if not rights.may_lock(status_kilobytes("VmSize") * 1024 + refusals.ROOM):
            return refusals.of_memory(rights)
        number = calls.lock_all()
        return refusals.of_memory(rights, number) if number else None


_LOCK = _Lock()
take, give_back = _LOCK.take, _LOCK.give_back


def locked_bytes() -> int:
    """Return the size (bytes) of all locked memory mappings of this process, including pages that were not used yet."""
    return status_kilobytes("VmLck") * 1024


def locked_before() -> list[LockedRange] | None:
    """Return the address ranges that are locked in memory now; None if the program has locked all of its memory."""
    if locked_bytes() == 0:
        return []
    with mmap.mmap(-1, mmap.PAGESIZE) as probe:
        word = ctypes.c_char.from_buffer(probe)
        fresh = ctypes.addressof(word)
        ranges = locked_ranges(text_of(ROOT / "proc/self/smaps"))
        del word
    return None if any(pages.start <= fresh < pages.end for pages in ranges) else ranges


def locked_ranges(smaps: str) -> list[LockedRange]:
    """Return the locked address ranges that a text in the format of /proc/self/smaps lists."""
    found = []
    start = end = 0
    for line in smaps.splitlines():
        match = _MAPPING.match(line)
        if match:
            start, end = int(match[1], 16), int(match[2], 16)
        elif line.startswith("VmFlags:") and "lo" in (flags := line.split()):
            found.append(LockedRange(start, end, "lf" in flags))
    return found
