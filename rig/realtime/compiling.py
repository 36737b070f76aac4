"""Who wants to know that machine code is being made: a command, which would otherwise be silent for half a minute.

Knows nothing of the compiler, so that a command that compiles nothing does not load it.

`rig.cli` and the console's workers listen; `rig.realtime.kernel` and `rig.realtime.parts` report to it. Nothing here
may import numba.
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


def began() -> None:
    """A function is being compiled; those that it calls are compiled within it."""
    _move(1)


def ended() -> None:
    """That function is compiled, or cannot be."""
    _move(-1)


def counted() -> None:
    """One more kernel is typed and lowered."""
    _count["kernels"] += 1


def kernels() -> int:
    """Number of kernels that this process has typed and lowered."""
    return _count["kernels"]


def _move(step: int) -> None:
    global _depth
    with _lock:
        before, _depth = _depth, _depth + step
        if (before == 0) != (_depth == 0):
            for listener in _listeners:
                listener(_depth > 0)
