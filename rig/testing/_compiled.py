"""Check that a compiled function of the loop allocates no memory and writes only to its own arrays."""

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
    """Return a copy of an array with guard values around it, and a function that returns True if they are unchanged.

    Compiled code does not check indices, so a write outside of the array would go unnoticed otherwise.
    """
    whole = np.full(len(memory) + 2 * GUARD, _MARK, dtype=memory.dtype)
    inside = whole[GUARD : GUARD + len(memory)]
    inside[:] = memory
    outside = np.r_[0:GUARD, GUARD + len(memory) : len(whole)]
    return inside, lambda: bool((whole[outside] == _MARK).all())


def allocations(run: Callable[[], object]) -> int:
    """Return the number of heap allocations of compiled code during a run, including one for each array argument.

    If the number is the same for more ticks, a tick allocates nothing. Return 0 if compilation is disabled.
    """
    if numba.config.DISABLE_JIT:
        return 0
    return count_allocations(run)
