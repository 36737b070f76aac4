"""Signal handlers for a while, and signals that must wait.

Loop, recorder, doctor and sweeps call it. It must not decide what a signal stops (`rig.realtime.stop_requests`).
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def handled(numbers: tuple[int, ...], handler: Callable[[int, Any], None]) -> Iterator[bool]:
    """Give these signals to `handler`, except those that are ignored; then to whom they belonged.

    Only the main thread gets signals: elsewhere nothing is changed, and what it yields is false.
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
        # In reverse, so that of SIGINT, named first, comes last: it may raise here, and what follows would not be done.
        for number in reversed(taken):
            signal.signal(number, before[number])


_waiting: list[int] = []
_handled_by: dict[int, Any] = {}


@contextmanager
def interrupts_later() -> Iterator[None]:
    """Let SIGINT and SIGTERM wait until `interrupts_now`, or until the end of this, whatever it calls.

    Where C calls back into Python, and where objects are finalised, the interpreter prints an exception and forgets it:
    a KeyboardInterrupt raised there, as inside a compiler, would be lost.
    """
    if _handled_by or not _in_the_main_thread():  # within another: as that one does
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    _handled_by.update({number: signal.getsignal(number) for number in numbers})
    try:
        with handled(numbers, lambda number, frame: _waiting.append(number)):
            yield
    finally:
        _handled_by.clear()
        for number in _came():
            signal.raise_signal(number)


def interrupts_now() -> None:
    """Let what waits interrupt here, where an exception is heard."""
    if _waiting and _in_the_main_thread():
        for number in _came():
            if callable(_handled_by[number]):
                _handled_by[number](number, None)
            else:  # the system's own action, which ends the process
                signal.signal(number, _handled_by[number])
                signal.raise_signal(number)


def take_no_signals() -> None:
    """Keep signals from the calling thread, not the main one: they are for Python, and would wake a wait early.

    Windows gives them to no thread: the interpreter only notes them for its main one.
    """
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())


def _came() -> list[int]:
    """Return those that waited, which wait no more: after the first interruption the others have none to make."""
    came = _waiting.copy()
    _waiting.clear()
    return came


def _in_the_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
