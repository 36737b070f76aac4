"""Install signal handlers temporarily, and defer signals while code runs that must not be interrupted.

The loop, the recorder, the doctor and sweeps use it. What a signal stops is decided elsewhere
(`rig.realtime.stop_requests`).
"""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def handle_signals(numbers: tuple[int, ...], handler: Callable[[int, Any], None]) -> Iterator[bool]:
    """Install `handler` for the signals `numbers` within this context; restore the previous handlers at its end.

    Yield True. An ignored signal remains ignored. Outside the main thread, where Python allows no handlers, change
    nothing and yield False.
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


_deferred: list[int] = []
_handled_by: dict[int, Any] = {}


@contextmanager
def interrupts_later() -> Iterator[None]:
    """Defer the signals SIGINT and SIGTERM until this context ends or `interrupts_now` is called."""
    # Where C calls back into Python, and where objects are finalised, the interpreter prints an exception and drops it:
    # a KeyboardInterrupt raised there, as inside a compiler, would be lost.
    if _handled_by or not _in_the_main_thread():  # within another: as that one does
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    _handled_by.update({number: signal.getsignal(number) for number in numbers})
    try:
        with handle_signals(numbers, lambda number, frame: _deferred.append(number)):
            yield
    finally:
        _handled_by.clear()
        for number in _pop_deferred():
            signal.raise_signal(number)


def interrupts_now() -> None:
    """Handle the signals that `interrupts_later` deferred; their exceptions (KeyboardInterrupt) reach the caller."""
    if _deferred and _in_the_main_thread():
        for number in _pop_deferred():
            if callable(_handled_by[number]):
                _handled_by[number](number, None)
            else:  # the system's own action, which ends the process
                signal.signal(number, _handled_by[number])
                signal.raise_signal(number)


def take_no_signals() -> None:
    """Block all signals in the calling thread, whose system calls then do not end early; not for the main thread."""
    # Windows delivers signals to no thread; its interpreter notes them for the main one.
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())


def _pop_deferred() -> list[int]:
    """Return the numbers of the deferred signals and clear the list, so that each signal is handled once."""
    came = _deferred.copy()
    _deferred.clear()
    return came


def _in_the_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
