"""The memories (`rig.realtime.ring`) of the loops that run on this computer, found and told to stop.

By the modules that an interpreter has loaded anyway, because the word that stops a rig must not wait for any other:
`rig.__main__` says it before it looks at the rest of its command line.
"""

from __future__ import annotations

import fcntl
import mmap
import os
from collections.abc import Iterator

LAYOUT_VERSION = 4
CONTROL_BYTES = 512
NAME = "haptic-rig"
LINK = f"/memfd:{NAME} (deleted)"

# Control words, of which the first three keep their places in all versions; `rig.realtime.ring` has the others.
VERSION, STOP, LOOP_DONE = 0, 3, 7
CREATOR = 63

_PROC = "/proc"


class Memory:
    """The control words of a loop, open until `close`; for a use in ``with``.

    Attributes
    ----------
    pid
        Process that made it.
    path
        Where that process has it open, ``/proc/PID/fd/N``.
    held
        Where this process has, though the other may have gone meanwhile.
    ran
        Whether its loop had not ended when it was told to stop.

    Raises
    ------
    OSError
        The process is gone or somebody else's, or this is no such memory.
    """

    def __init__(self, pid: int, path: str) -> None:
        self.pid, self.path = pid, path
        self.ran = False
        self._descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        self.held = f"{_PROC}/self/fd/{self._descriptor}"
        try:
            if not fcntl.fcntl(self._descriptor, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SHRINK:
                raise OSError(f"{path} can shrink under its reader")
            self.words = memoryview(mmap.mmap(self._descriptor, CONTROL_BYTES)).cast("q")
        except (OSError, ValueError) as error:
            os.close(self._descriptor)
            raise OSError(f"{path} is not the memory of a running loop") from error

    def ask_to_stop(self) -> None:
        """Set the stop word, unless it is set."""
        if self.words[VERSION] != 0:
            self.ran = self.words[LOOP_DONE] == 0
            if self.words[STOP] == 0:
                self.words[STOP] = 1

    def made_by(self, pid: int) -> bool:
        """Whether a process made what it has open: others look at it too, and forks inherit it without its loop.

        In a container the creator calls itself by another number; the kernel knows both.
        """
        if self.words[VERSION] != LAYOUT_VERSION:
            return self.words[VERSION] != 0
        creator = self.words[CREATOR]
        if creator == pid:
            return True
        with open(f"{_PROC}/{pid}/status", encoding="ascii", errors="replace") as status:
            for line in status:
                if line.startswith("NSpid:"):
                    return creator in [int(number) for number in line.split()[1:]]
        return False

    def close(self) -> None:
        """Let go of it; may be called twice."""
        if self._descriptor >= 0:
            self.words.release()
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> Memory:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def is_memory(path: str) -> bool:
    """Whether a path of an open file leads to such a memory."""
    try:
        return os.readlink(path) == LINK
    except OSError:
        return False


def memories(pid: int | None = None) -> Iterator[Memory]:
    """Each memory once, under the process that made it, or those of one process; the caller closes them.

    What vanishes meanwhile is left out.
    """
    known: set[tuple[int, int]] = set()
    for process in os.listdir(_PROC) if pid is None else [str(pid)]:
        if not process.isdecimal():
            continue
        try:
            paths = [f"{_PROC}/{process}/fd/{name}" for name in os.listdir(f"{_PROC}/{process}/fd")]
        except OSError:  # the process ended, or is somebody else's
            continue
        for path in filter(is_memory, paths):
            try:
                place = os.stat(path)
                memory = Memory(int(process), path)
            except OSError:
                continue
            if (place.st_dev, place.st_ino) not in known and _made_by(memory):
                known.add((place.st_dev, place.st_ino))
                yield memory
            else:
                memory.close()


def _made_by(memory: Memory) -> bool:
    try:
        return memory.made_by(memory.pid)
    except OSError:
        return False


def ask_to_stop(pid: int | None = None) -> list[Memory]:
    """Set the stop words of a process's loops, or of all of this user, and return at once; the caller closes them."""
    asked = []
    for memory in memories(pid):
        memory.ask_to_stop()
        asked.append(memory)
    return asked
