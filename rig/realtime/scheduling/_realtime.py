"""The context of a run in real time: what was asked, what was obtained, and everything undone at the end."""

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
    """Scheduling that a run requested and was granted; made by `obtained`.

    Attributes
    ----------
    messages
        One sentence for each refusal, with its remedy, to be printed. `enter_thread` may add to them.
    refusals
        The same with their parts.
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
        """Return sentences to print, each refusal with its remedy; empty when all was granted or nothing requested."""
        return [check.sentence for check in self.refusals]

    @property
    def report(self) -> dict[str, Any]:
        """Return what was requested, granted and refused, and the kernel's facts: JSON types, for a recording's header.

        Empty in virtual time. Until a thread has entered, its part is what a thread that was tried obtained.
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
        """Request everything and note what is refused; `undo` takes back what was granted."""
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
        """End the asking: a thread that comes later stays as it is."""
        self._active = False

    def enter_thread(self) -> ThreadState | None:
        """Schedule the calling thread as asked and bring its stack into memory; return how it runs now.

        It never raises: what is refused here, though it was granted a moment ago, goes to `messages`. None in
        virtual time, where nothing is touched.
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
        """Undo the latest `enter_thread` of the calling thread; needed only by threads that live on."""
        if stack := self._stack():
            thread.restore(stack.pop())

    def prefault(self, *arrays: NDArray[Any]) -> None:
        """Bring the pages of arrays into memory, ready to be written; their content stays. Nothing when off."""
        if not self._active:
            return
        for array in arrays:
            if array.size:
                spans = [step * (count - 1) for step, count in zip(array.strides, array.shape, strict=True)]
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
    """Real-time scheduling for as long as the context lasts; everything is as before when it ends.

    The process gets locked memory and processors that do not sleep deeply; what the loop's thread may have is tried
    in a thread of its own, so that a refusal is known before anything moves. The thread itself calls
    `Realtime.enter_thread`. Contexts may be nested and used from several threads.

    Parameters
    ----------
    host
        ``experiment.host``. With ``realtime = "off"`` nothing is touched.
    virtual
        Virtual time needs none of it: nothing is touched, whatever `host` is.

    Raises
    ------
    RealtimeError
        ``realtime = "enforce"`` and something is refused; the message names all of it, and nothing is changed.
    """
    realtime = Realtime(host, active=not virtual and host.realtime != "off", virtual=virtual)
    with ExitStack() as undo:
        if not virtual and host.realtime != "off":
            realtime.ask(undo)
            if realtime.refusals and host.realtime == "enforce":
                raise _refused(realtime.refusals)
        try:
            yield realtime
        finally:
            realtime.close()


def _refused(refusals: list[Check]) -> RealtimeError:
    remedies = dict.fromkeys(check.remedy for check in refusals if check.remedy)
    return RealtimeError(
        f'host.realtime = "enforce", but {"; ".join(check.text for check in refusals)}',
        remedy="; ".join((*remedies, 'or set host.realtime = "try"')),
    )
