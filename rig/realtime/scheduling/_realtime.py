"""Context of a run in real time: it requests scheduling, reports what was granted, and undoes it at the end.

Trials, motions and simulated devices enter it. It must not request anything in virtual time.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from rig.core.check import Check
from rig.core.errors import RealtimeError
from rig.realtime.scheduling import _calls as calls
from rig.realtime.scheduling import _idle as idle
from rig.realtime.scheduling import _memory as memory
from rig.realtime.scheduling import _thread as thread
from rig.realtime.scheduling import facts
from rig.realtime.scheduling._request import RealtimeRequest
from rig.realtime.scheduling.refusals import of_idle

if TYPE_CHECKING:
    from numpy.typing import NDArray


if sys.platform == "linux":
    from rig.realtime.scheduling._thread import ThreadState

assert sys.platform == "linux"


class Realtime:
    """Real-time scheduling that a run requested, and what the system granted; `obtained` creates it.

    Attributes
    ----------
    messages
        One sentence to print for each refused request, with its remedy. `enter_thread` may add to them.
    refusals
        The refused requests as failed checks (`rig.core.check.Check`).
    """

    def __init__(self, host: RealtimeRequest, *, active: bool, virtual: bool = False) -> None:
        self.refusals: list[Check] = []
        self._host = host
        self._active = active
        self._virtual = virtual
        self._latency_us: int | None = None
        self._locked = 0
        self._thread: ThreadState | None = None
        self._before = threading.local()

    @property
    def messages(self) -> list[str]:
        """Return one sentence to print for each refusal of the system, with its remedy; empty without refusals."""
        return [check.sentence for check in self.refusals]

    @property
    def report(self) -> dict[str, Any]:
        """Return requested, granted and refused scheduling, and facts of the kernel, as JSON types for a recording.

        The result is empty in virtual time. Before the loop's thread calls `enter_thread`, the entry "obtained"
        describes a short test thread, for which the same scheduling was requested.
        """
        if self._virtual:
            return {}
        state = self._thread or ThreadState.here()
        host = self._host
        return {
            "asked": {"realtime": host.realtime, "priority": host.priority, "cpu": host.cpu},
            "obtained": {
                **state.as_mapping(),
                "locked_bytes": self._locked,
                "cpu_latency_us": self._latency_us,
            },
            "refusals": [refusal.text for refusal in self.refusals],
            "machine": facts.describe_scheduling(host.cpu),
        }

    def ask(self, undo: ExitStack) -> None:
        """Request scheduling, locked memory and no deep sleep; store refusals; `undo` gets what revokes the rest."""
        self._thread, refused = thread.tried(self._host.priority, self._host.cpu)
        refusal = memory.take()
        if refusal is None:
            undo.callback(memory.give_back)
            self._locked = memory.locked_bytes()
        else:
            refused.append(refusal)
        try:
            undo.callback(os.close, idle.hold())
            self._latency_us = idle.LATENCY_US
        except OSError as error:
            if (sleeping := of_idle(error.errno or 0)) is not None:
                refused.append(sleeping)
        self.refusals += refused

    def close(self) -> None:
        """Stop requesting: after `close`, `enter_thread` does not change the scheduling of a thread."""
        self._active = False

    def enter_thread(self) -> ThreadState | None:
        """Give the calling thread the requested scheduling, load its stack into memory, and return its new state.

        It never raises; refusals are added to `messages`. In virtual time it does nothing and returns None.
        """
        if self._virtual:
            return None
        if self._active:
            before = ThreadState.here()
            self._stack().append(before)
            for refusal in thread.raise_thread(self._host.priority, self._host.cpu):
                if refusal not in self.refusals:
                    self.refusals.append(refusal)
            thread.touch_stack()
        self._thread = ThreadState.here()
        return self._thread

    def leave_thread(self) -> None:
        """Restore the calling thread's scheduling before `enter_thread`, if the thread continues after the run."""
        if stack := self._stack():
            thread.restore(stack.pop())

    def prefault(self, *arrays: NDArray[Any]) -> None:
        """Load the memory pages of arrays, writable, to avoid page faults in a run, unless ``realtime="off"``."""
        if not self._active:
            return
        for array in arrays:
            if array.size:
                spans = [step * (count - 1) for step, count in zip(array.strides, array.shape, strict=True)]
                # An array with a negative stride begins above its lowest address.
                low = sum(span for span in spans if span < 0)
                high = sum(span for span in spans if span > 0) + array.itemsize
                calls.touch(array.ctypes.data + low, high - low)

    def _stack(self) -> list[ThreadState]:
        if not hasattr(self._before, "states"):
            self._before.states = []
        states: list[ThreadState] = self._before.states
        return states


@contextmanager
def obtained(host: RealtimeRequest, *, virtual: bool = False) -> Iterator[Realtime]:
    """Request real-time scheduling for a run within this context; the previous state is restored at its end.

    The memory of the process is locked, and processors are kept from deep sleep. The scheduling of the loop's thread is
    tested in a separate thread, so that a refusal is known before anything moves; the loop's thread must call
    `Realtime.enter_thread`. Contexts may be nested and used from several threads. Raise `RealtimeError` if ``realtime =
    "enforce"`` is set and the system refuses one of the requests: the message names all refusals, and nothing is
    changed.

    Parameters
    ----------
    host
        Request, for example ``experiment.host``. With ``realtime = "off"`` nothing is changed.
    virtual
        True for a run in virtual time: nothing is changed, whatever `host` requests.
    """
    realtime = Realtime(host, active=not virtual and host.realtime != "off", virtual=virtual)
    with ExitStack() as undo:
        if not virtual and host.realtime != "off":
            realtime.ask(undo)
            if realtime.refusals and host.realtime == "enforce":
                raise _enforce_error(realtime.refusals)
        try:
            yield realtime
        finally:
            realtime.close()


def _enforce_error(refusals: list[Check]) -> RealtimeError:
    remedies = dict.fromkeys(check.remedy for check in refusals if check.remedy)
    return RealtimeError(
        f'host.realtime = "enforce", but {"; ".join(check.text for check in refusals)}',
        remedy="; ".join((*remedies, 'or set host.realtime = "try"')),
    )
