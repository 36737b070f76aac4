"""The resources of a process before and after a test: threads, descriptors, children, memory, scheduling, signals.

A run may use all of them, but must leave them unchanged. `Census.of_self` reads those of this process; `marked` finds
the processes that a command started by a mark in their environment, even after their parent has died.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

SETTLED_S = 10.0  # for what the kernel takes away a little later, on a loaded machine
MARK = "HAPTIC_RIG_TEST_MARK"
SHARED_MEMORY = ("/dev/shm/", "/memfd:", "/SYSV")


@dataclass(frozen=True, slots=True)
class Census:
    """The resources of this process at one time."""

    threads: tuple[str, ...]  # of Python, by name
    tasks: int  # of the kernel, Python's and all others
    descriptors: tuple[str, ...]  # what each open one leads to
    children: tuple[int, ...]
    mappings: tuple[str, ...]  # of shared memory
    segments: tuple[str, ...]  # ours in /dev/shm
    locked_kb: int
    policy: int
    priority: int
    affinity: tuple[int, ...]
    nice: int
    timer_slack_ns: int
    blocked: tuple[int, ...]  # signals
    handlers: tuple[str, ...]
    collecting: bool
    switch_interval_s: float
    limits: tuple[tuple[int, int], ...]

    @classmethod
    def of_self(cls) -> Census:
        import resource  # noqa: PLC0415

        return cls(
            threads=tuple(sorted(thread.name for thread in threading.enumerate())),
            tasks=len(os.listdir("/proc/self/task")),
            descriptors=_descriptors(),
            children=children(),
            mappings=_mappings(),
            segments=tuple(
                sorted(name for name in _listed("/dev/shm") if "haptic" in name or "rig-" in name)
            ),
            locked_kb=_status("VmLck"),
            policy=os.sched_getscheduler(0),
            priority=os.sched_getparam(0).sched_priority,
            affinity=tuple(sorted(os.sched_getaffinity(0))),
            nice=os.getpriority(os.PRIO_PROCESS, 0),
            timer_slack_ns=int(Path("/proc/self/timerslack_ns").read_text()),
            blocked=tuple(sorted(signal.pthread_sigmask(signal.SIG_BLOCK, []))),
            handlers=tuple(repr(signal.getsignal(number)) for number in (signal.SIGINT, signal.SIGTERM)),
            collecting=gc.isenabled(),
            switch_interval_s=sys.getswitchinterval(),
            limits=tuple(
                resource.getrlimit(limit)
                for limit in (resource.RLIMIT_MEMLOCK, resource.RLIMIT_RTPRIO, resource.RLIMIT_NOFILE)
            ),
        )

    def changes(self, after: Census) -> dict[str, tuple[Any, Any]]:
        """Return the resources that changed, as (before, after)."""
        old, new = asdict(self), asdict(after)
        return {name: (old[name], new[name]) for name in old if old[name] != new[name]}


def _wait_until_stable() -> Census:
    """Return a census that a second one confirms, because a joined thread may still be in the kernel."""
    deadline = time.monotonic() + SETTLED_S
    seen = Census.of_self()
    while time.monotonic() < deadline:
        time.sleep(0.01)
        again = Census.of_self()
        if again == seen:
            break
        seen = again
    return seen


@contextmanager
def nothing_left() -> Iterator[None]:
    """Check that this process has the same resources after the block as before."""
    gc.collect()  # what earlier tests dropped goes before, not meanwhile
    before = _wait_until_stable()
    yield
    deadline = time.monotonic() + SETTLED_S
    while (changes := before.changes(Census.of_self())) and time.monotonic() < deadline:
        time.sleep(0.01)
        gc.collect()  # a caller may still hold the error that ended a run, with its frames
    assert not changes, changes


def marked(mark: str, variable: str = MARK) -> dict[int, str]:
    """Return the processes with this mark in their environment: number → command line and name of the test."""
    found = {}
    for name in _listed("/proc"):
        if not name.isdecimal():
            continue
        with suppress(OSError):  # it ended, or belongs to another user
            directory = Path("/proc") / name
            environment = (directory / "environ").read_bytes().split(b"\0")
            if f"{variable}={mark}".encode() in environment:
                of = [entry for entry in environment if entry.startswith(b"PYTEST_CURRENT_TEST=")]
                text = (directory / "cmdline").read_bytes().replace(b"\0", b" ") + b" ".join(of)
                found[int(name)] = text.decode("utf-8", "replace")
    return found


def still_there(mark: str, variable: str = MARK) -> dict[int, str]:
    """Return the processes with this mark that do not end by themselves."""
    deadline = time.monotonic() + SETTLED_S
    while (found := marked(mark, variable)) and time.monotonic() < deadline:
        time.sleep(0.05)
    return found


def _descriptors() -> tuple[str, ...]:
    found = []
    for name in _listed("/proc/self/fd"):
        with suppress(OSError):  # the one that listed the directory
            found.append(os.readlink(f"/proc/self/fd/{name}"))
    return tuple(sorted(found))


def children() -> tuple[int, ...]:
    """Return the children of this process that it has not waited for."""
    found: list[int] = []
    for task in _listed("/proc/self/task"):
        with suppress(OSError):
            found += map(int, Path(f"/proc/self/task/{task}/children").read_text().split())
    return tuple(sorted(found))


def _mappings() -> tuple[str, ...]:
    with open("/proc/self/maps", encoding="utf-8", errors="replace") as file:
        paths = [line.split(maxsplit=5)[5].strip() for line in file if len(line.split(maxsplit=5)) == 6]
    return tuple(sorted({path for path in paths if path.startswith(SHARED_MEMORY)}))


def _status(name: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1])
    return 0


def _listed(directory: str) -> list[str]:
    try:
        return os.listdir(directory)
    except OSError:
        return []
