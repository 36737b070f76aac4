"""Listeners for the begin and end of compilation, during which a command would be silent for half a minute.

`rig.cli` and the console's workers listen; `rig.realtime.kernel` and `rig.realtime.parts` report to it. Nothing here
may import numba: a command that compiles nothing must not load it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

_lock = threading.Lock()
_depth = 0
_listeners: list[Callable[[bool], None]] = []
_count = {"kernels": 0}


def listen(listener: Callable[[bool], None]) -> None:
    """Call `listener(True)` when compiling begins, `listener(False)` when it ends, in whatever thread that is."""
    _listeners.append(listener)


def report_begin() -> None:
    """Report that a function is being compiled; those that it calls are compiled within it."""
    _move(1)


def report_end() -> None:
    """Report that this function is compiled, or cannot be."""
    _move(-1)


def count_kernel() -> None:
    """Count one more kernel that was typed and lowered."""
    _count["kernels"] += 1


def kernels() -> int:
    """Return the number of kernels that this process has typed and lowered."""
    return _count["kernels"]


def _move(step: int) -> None:
    global _depth
    with _lock:
        # Compilations nest and run in several threads: only the outermost begin and the last end are reported.
        before, _depth = _depth, _depth + step
        if (before == 0) != (_depth == 0):
            for listener in _listeners:
                listener(_depth > 0)
