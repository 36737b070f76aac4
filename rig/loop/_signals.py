"""Ctrl-C, SIGTERM and a closed terminal as a stop of the loop, and never as an exception in the middle of a run.

`rig.realtime.stop_requests` stops the loop at once, in whichever thread it runs. What is added here is for a run in the
main thread, where Python's handlers raise: they are replaced meanwhile, and called all the same.
"""

from __future__ import annotations

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
    """Causes that stopped a run from outside; all but `series` are set when the run is over.

    Attributes
    ----------
    series
        The runs that this one belongs to.
    is_stopped, number
        True if a stop was requested, and the number of the signal that did so, if one.
    raised
        Exception that a handler of the caller raised, other than KeyboardInterrupt.
    """

    series: RunSeries
    is_stopped: bool = False
    number: int | None = None
    raised: BaseException | None = None


@contextmanager
def stop_on_signals() -> Iterator[Signals]:
    """Let signals stop the loop instead of raising here, as often as they come.

    An exception in between, from the first or from a second signal, could cut short what brings the rig to rest. A
    handler that the caller had set is called at once, and what it raises waits for the end of the run. A signal that
    comes while the old handlers return is given to them, when everything is as it was.
    """
    received: int | None = None
    before: dict[int, Any] = {number: signal.getsignal(number) for number in STOPPING}

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
