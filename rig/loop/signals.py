"""Ctrl-C, SIGTERM and a closed terminal as a stop of the loop, whoever holds the GIL.

The interpreter runs signal handlers in the main thread when that gets the GIL, which a busy program may keep from it
for seconds. But its handler in C writes the number of each signal to a descriptor at once (`signal.set_wakeup_fd`), and
the compiled loop looks there in every tick. The handlers here do the same a second time, for a loop that has ended.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from rig.realtime.ring import STOP, Ring

STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass(frozen=True, slots=True)
class Signals:
    """Signals received so far, and the descriptor on which the loop sees them (-1: none)."""

    descriptor: int = -1
    seen: list[int] = field(default_factory=list)


@contextmanager
def stop_on_signals(ring: Ring) -> Iterator[Signals]:
    """Let signals stop the loop instead of raising here, as often as they come.

    An exception in between, from the first or from a second signal, could cut short what brings the rig to rest.
    Only the main thread gets signals: elsewhere nothing is changed. Ignored ones stay ignored. One that comes while
    the old handlers return is given to them, when everything is as it was.
    """
    if threading.current_thread() is not threading.main_thread():
        yield Signals()
        return
    reader, writer = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    signals = Signals(reader)

    def stop(number: int, frame: object) -> None:
        signals.seen.append(number)
        ring.put(STOP, 1)

    before: dict[int, Any] = {number: signal.getsignal(number) for number in STOPPING}
    taken = [number for number, handler in before.items() if handler not in (None, signal.SIG_IGN)]
    woken = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    try:
        for number in taken:
            signal.signal(number, stop)
        yield signals
    finally:
        heard = len(signals.seen)
        signal.set_wakeup_fd(woken)
        os.close(reader)
        os.close(writer)
        # SIGINT last: its handler may raise here, and what follows would not be done.
        for number in reversed(taken):
            signal.signal(number, before[number])
        for number in signals.seen[heard:]:
            signal.raise_signal(number)
