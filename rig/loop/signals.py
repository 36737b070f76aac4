"""Ctrl-C, SIGTERM and a closed terminal as a stop of the loop, whoever holds the GIL.

The interpreter runs signal handlers in the main thread when that gets the GIL, which a busy program may keep from it
for seconds. But its handler in C writes the number of each signal to a descriptor at once (`signal.set_wakeup_fd`), and
in real time the compiled loop looks there in every tick. The handlers here do the same a second time, for a loop that
has ended, or runs in virtual time.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from rig.realtime.handlers import handled
from rig.realtime.ring import STOP, Ring

if sys.platform == "win32":
    STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGBREAK)
else:
    STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Signals(NamedTuple):
    """Descriptor on which the loop sees signals (-1: none), and those received so far."""

    descriptor: int
    seen: list[int]


@contextmanager
def stop_on_signals(ring: Ring) -> Iterator[Signals]:
    """Let signals stop the loop instead of raising here, as often as they come.

    An exception in between, from the first or from a second signal, could cut short what brings the rig to rest.
    One that comes while the old handlers return is given to them, when everything is as it was.
    """
    seen: list[int] = []
    heard = 0

    def stop(number: int, frame: object) -> None:
        seen.append(number)
        ring.put(STOP, 1)

    try:
        with handled(STOPPING, stop) as here, _wake_up(here) as descriptor:
            try:
                yield Signals(descriptor, seen)
            finally:
                heard = len(seen)
    finally:
        for number in seen[heard:]:
            signal.raise_signal(number)


@contextmanager
def _wake_up(here: bool) -> Iterator[int]:
    """Descriptor to which the interpreter writes signals as they come; -1 in a thread that gets none.

    Off Linux compiled code reads no descriptors, and the handlers alone tell a loop.
    """
    if sys.platform == "linux" and here:
        reader, writer = os.pipe2(os.O_NONBLOCK)
        woken = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        try:
            yield reader
        finally:
            signal.set_wakeup_fd(woken)
            os.close(reader)
            os.close(writer)
    else:
        yield -1
