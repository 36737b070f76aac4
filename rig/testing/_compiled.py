"""Requirements on any compiled function that runs in the loop: it allocates nothing and keeps to its memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from rig.realtime.parts import count_allocations

GUARD = 16  # numbers on each side of a memory that compiled code must not write
_MARK = 12345


def guarded(memory: NDArray[Any]) -> tuple[NDArray[Any], Callable[[], bool]]:
    """Return a copy of a memory between marks, and whether they are untouched: compiled code checks no index."""
    whole = np.full(len(memory) + 2 * GUARD, _MARK, dtype=memory.dtype)
    inside = whole[GUARD : GUARD + len(memory)]
    inside[:] = memory
    outside = np.r_[0:GUARD, GUARD + len(memory) : len(whole)]
    return inside, lambda: bool((whole[outside] == _MARK).all())


def allocations(run: Callable[[], object]) -> int:
    """Return how often compiled code asks the heap for memory during a run, once for each array that it is given.

    So the same count for more ticks says that a tick asks for none. 0 where nothing is compiled.
    """
    if numba.config.DISABLE_JIT:
        return 0
    return count_allocations(run)
