"""Scheduling of the calling thread: policy, processor, timer slack and stack.

`_realtime` uses it. It must not change another thread.
"""

from __future__ import annotations

import os
import sys
import threading
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

from rig.core.check import Check
from rig.realtime.scheduling import _calls as calls
from rig.realtime.scheduling import refusals
from rig.realtime.scheduling._rights import Rights

assert sys.platform == "linux"

STACK_BYTES = 512 * 1024  # from the top: frames of Python, of the loop and of the functions that they call
SHORTEST_SLACK_NS = 1
SHORTEST_SLICE_NS = 100_000  # smallest slice that the kernel grants
_POLICIES = {
    getattr(os, name): name
    for name in ("SCHED_OTHER", "SCHED_BATCH", "SCHED_IDLE", "SCHED_FIFO", "SCHED_RR")
    if hasattr(os, name)
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ThreadState:
    """Scheduling of one thread; `policy` includes the bit SCHED_RESET_ON_FORK if it is set."""

    policy: int
    priority: int
    cpus: tuple[int, ...]
    timer_slack_ns: int

    @classmethod
    def here(cls) -> ThreadState:
        """Return the present scheduling of the calling thread."""
        return cls(
            policy=os.sched_getscheduler(0),
            priority=os.sched_getparam(0).sched_priority,
            cpus=tuple(sorted(os.sched_getaffinity(0))),
            timer_slack_ns=calls.timer_slack(),
        )

    @property
    def is_fifo(self) -> bool:
        """Return True if the thread has the policy SCHED_FIFO: it runs before every ordinary thread until it waits."""
        return self.policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO

    @property
    def name(self) -> str:
        """Return the name of the thread's scheduling policy, such as "SCHED_FIFO"."""
        plain = self.policy & ~os.SCHED_RESET_ON_FORK
        return _POLICIES.get(plain, str(plain))

    def as_mapping(self) -> dict[str, Any]:
        """Return policy, priority, processors and timer slack (ns) of the thread as JSON types."""
        return {**asdict(self), "policy": self.name, "cpus": list(self.cpus)}


def raise_thread(priority: int, cpu: int | None) -> list[Check]:
    """Request SCHED_FIFO with a priority (1 to 99) and a processor for the calling thread; return what was refused.

    If SCHED_FIFO is refused, the thread gets the shortest timer slack and time slice instead, which need no rights.
    With `cpu` None the thread may run on any processor.
    """
    refused = []
    if cpu is not None:
        try:
            os.sched_setaffinity(0, {cpu})
        except (OSError, ValueError, OverflowError) as error:
            refused.append(refusals.of_processor(cpu, getattr(error, "errno", None) or 22))
    try:
        # Children of this thread start as ordinary ones: a process that it starts must not outrun the machine.
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as error:
        refused.append(refusals.of_policy(priority, Rights.here(), error.errno or 1))
        if not ThreadState.here().is_fifo:
            calls.set_timer_slack(SHORTEST_SLACK_NS)
            calls.set_slice(SHORTEST_SLICE_NS)
    return refused


def restore(before: ThreadState) -> None:
    """Restore scheduling policy, processors and timer slack of the calling thread as `before` describes them."""
    parameter = os.sched_param(before.priority)
    try:
        os.sched_setscheduler(0, before.policy, parameter)
    except OSError:
        # Without CAP_SYS_NICE the kernel keeps "children do not inherit": it changes nothing for an ordinary thread.
        with suppress(OSError):
            os.sched_setscheduler(0, before.policy | os.SCHED_RESET_ON_FORK, parameter)
    with suppress(OSError):
        os.sched_setaffinity(0, set(before.cpus))
    if before.timer_slack_ns > 0:  # a real-time thread has none, and 0 would mean the default
        calls.set_timer_slack(before.timer_slack_ns)


def touch_stack() -> None:
    """Load `STACK_BYTES` (512 KiB) of the calling thread's stack into memory: the depth that the loop needs."""
    top = calls.stack_top()
    if top and threading.current_thread() is not threading.main_thread():  # whose stack grows by itself
        calls.touch(top - STACK_BYTES, STACK_BYTES)


def tried(priority: int, cpu: int | None) -> tuple[ThreadState, list[Check]]:
    """Request SCHED_FIFO and a processor for a short test thread; return what it was granted and what was refused."""
    outcome: list[tuple[ThreadState, list[Check]]] = []

    def body() -> None:
        refused = raise_thread(priority, cpu)
        outcome.append((ThreadState.here(), refused))

    thread = threading.Thread(target=body, name="rig-scheduling-probe", daemon=True)
    thread.start()
    thread.join()
    return outcome[0]
