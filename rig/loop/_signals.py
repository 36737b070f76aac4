"""Convert Ctrl-C, SIGTERM and a closed terminal to a stop of the loop, never to an exception in the middle of a run.

`rig.realtime.stop_requests` stops the loop at once, in whichever thread it runs. This file is for a run in the main
thread, where Python's signal handlers raise exceptions: it replaces them during the run, and calls them itself. Trials
use it. It must not raise while the run brings the rig to rest.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rig.realtime import stop_requests
from rig.realtime.handlers import handle_signals
from rig.realtime.stop_requests import STOPPING, RunSeries


@dataclass(slots=True)
class Signals:
    """The signals that stopped a run; all attributes except `series` are set at the end of the run.

    Attributes
    ----------
    series
        Runs, this one included, that a single stop request ends together.
    is_stopped, number
        True if a stop was requested, and the number of the signal that requested it, None without a signal.
    raised
        Exception that the caller's own signal handler raised, None without one; KeyboardInterrupt is ignored.
    """

    series: RunSeries
    is_stopped: bool = False
    number: int | None = None
    raised: BaseException | None = None


@contextmanager
def stop_on_signals() -> Iterator[Signals]:
    """Return a context in which Ctrl-C, SIGTERM and a closed terminal stop the loop, and raise no exception.

    The caller's own signal handler is called at once; its exception is stored until the end of the run. A signal that
    arrives while the previous handlers are being restored is sent again to these.
    """
    received: int | None = None
    before: dict[int, Any] = {number: signal.getsignal(number) for number in STOPPING}

    # Never raise: an exception, also by a second signal, could interrupt the code that brings the rig to rest.
    def stop(number: int, frame: object) -> None:
        seen.append(number)
        if received is not None:
            return
        stop_requests.request(number)  # once more where it was counted in machine code
        if callable(before[number]):
            try:
                before[number](number, frame)
            except KeyboardInterrupt:  # what the run's own `StoppedError` says
                pass
            except BaseException as error:
                raised.append(error)

    seen: list[int] = []
    raised: list[BaseException] = []
    try:
        with handle_signals(STOPPING, stop), stop_requests.run() as series:
            signals = Signals(series)
            try:
                yield signals
            finally:
                received = len(seen)
                signals.is_stopped = series.is_stopped
                signals.number = seen[0] if seen else stop_requests.last_signal()
                signals.raised = raised[0] if raised else None
    finally:
        stop_requests.renew()
        for number in seen[received or 0 :]:
            signal.raise_signal(number)
