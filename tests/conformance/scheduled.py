"""The state of scheduling that tests compare; a child process imports it in a tenth of the time of pytest."""

import os
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from rig.realtime.scheduling import ThreadState, facts

CHILD_S = 60.0
PATIENCE_S = 5.0


@dataclass(frozen=True)
class Asked:
    """The part of `experiment.host` that scheduling reads."""

    realtime: str = "try"
    priority: int = 70
    cpu: int | None = None


def locked() -> int:
    return facts.status_kilobytes("VmLck")


def latency_requests() -> int:
    held = 0
    for name in os.listdir("/proc/self/fd"):
        try:
            held += os.readlink(f"/proc/self/fd/{name}") == "/dev/cpu_dma_latency"
        except OSError:
            continue
    return held


def all_threads() -> set[tuple[int, tuple[int, ...]]]:
    found = set()
    for task in map(int, os.listdir("/proc/self/task")):
        with suppress(ProcessLookupError):  # a thread that was joined is still here for a moment
            found.add((os.sched_getscheduler(task), tuple(sorted(os.sched_getaffinity(task)))))
    return found


def state() -> tuple[object, ...]:
    return locked(), latency_requests(), ThreadState.here(), os.sched_getaffinity(os.getpid())


def wait_for_state(before: object, now: Any) -> bool:
    """Wait until the state equals `before`: a joined thread stays in /proc for a moment."""
    deadline = time.monotonic() + PATIENCE_S
    while now() != before and time.monotonic() < deadline:
        time.sleep(0.01)
    return now() == before


def in_thread(function: Any) -> Any:
    with ThreadPoolExecutor(1) as fresh:
        return fresh.submit(function).result(CHILD_S)
