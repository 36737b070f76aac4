"""Notify listeners when the compilation of kernels begins and ends, so that a command can print why it waits.

Compilation takes up to half a minute. `rig.cli` and the console's workers listen; `rig.realtime.kernel` and
`rig.realtime.parts` report. This file must not import numba: a command that compiles nothing must not load it.
"""

import threading
from collections.abc import Callable

_lock = threading.Lock()
_depth = 0
_listeners: list[Callable[[bool], None]] = []
_count = {"kernels": 0}


def listen(listener: Callable[[bool], None]) -> None:
    """Call `listener(True)` whenever compilation begins and `listener(False)` when it ends, in the compiling thread."""
    _listeners.append(listener)


def report_begin() -> None:
    """Report that the compilation of a function begins; call `report_end` afterwards. Pairs of calls may nest."""
    _move(1)


def report_end() -> None:
    """Report that the compilation of a function has ended, successfully or not."""
    _move(-1)


def count_kernel() -> None:
    """Add one to the number of compiled functions that `kernels` returns."""
    _count["kernels"] += 1


def kernels() -> int:
    """Return the number of functions that numba has compiled, not loaded from the cache, in this process."""
    return _count["kernels"]


def _move(step: int) -> None:
    global _depth
    with _lock:
        # Compilations nest and run in several threads: only the outermost begin and the last end are reported.
        before, _depth = _depth, _depth + step
        if (before == 0) != (_depth == 0):
            for listener in _listeners:
                listener(_depth > 0)
