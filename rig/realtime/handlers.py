"""Install signal handlers temporarily, and defer signals.

The loop, the recorder, the doctor and sweeps call it. It must not decide what a signal stops
(`rig.realtime.stop_requests`).
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def handle_signals(numbers: tuple[int, ...], handler: Callable[[int, Any], None]) -> Iterator[bool]:
    """Install `handler` for signals, except those that are ignored; restore the previous handlers at the end.

    Yields True; outside the main thread, which alone receives signals, yields False and changes nothing.
    """
    if not _in_the_main_thread():
        yield False
        return
    before: dict[int, Any] = {number: signal.getsignal(number) for number in numbers}
    taken = [number for number, old in before.items() if old not in (None, signal.SIG_IGN)]
    try:
        for number in taken:
            signal.signal(number, handler)
        yield True
    finally:
        # In reverse, so that SIGINT, named first, is restored last: it may raise here, and the rest would be skipped.
        for number in reversed(taken):
            signal.signal(number, before[number])


_waiting: list[int] = []
_handled_by: dict[int, Any] = {}


@contextmanager
def interrupts_later() -> Iterator[None]:
    """Defer SIGINT and SIGTERM until `interrupts_now` is called or this context ends."""
    # Where C calls back into Python, and where objects are finalised, the interpreter prints an exception and drops it:
    # a KeyboardInterrupt raised there, as inside a compiler, would be lost.
    if _handled_by or not _in_the_main_thread():  # within another: as that one does
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    _handled_by.update({number: signal.getsignal(number) for number in numbers})
    try:
        with handle_signals(numbers, lambda number, frame: _waiting.append(number)):
            yield
    finally:
        _handled_by.clear()
        for number in _came():
            signal.raise_signal(number)


def interrupts_now() -> None:
    """Handle deferred signals now, so that their exception reaches the caller of this function."""
    if _waiting and _in_the_main_thread():
        for number in _came():
            if callable(_handled_by[number]):
                _handled_by[number](number, None)
            else:  # the system's own action, which ends the process
                signal.signal(number, _handled_by[number])
                signal.raise_signal(number)


def take_no_signals() -> None:
    """Block all signals in the calling thread, so that they do not end its waits early. Not for the main thread."""
    # Windows delivers signals to no thread; its interpreter notes them for the main one.
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())


def _came() -> list[int]:
    """Return the deferred signals and clear them, so that each is handled once."""
    came = _waiting.copy()
    _waiting.clear()
    return came


def _in_the_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
