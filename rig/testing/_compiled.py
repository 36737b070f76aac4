"""Check that a compiled function of the loop allocates no memory and writes only to its own arrays.

The checks of laws and estimators use it.
"""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from rig.realtime.parts import count_allocations

GUARD = 16  # numbers on each side of a memory that compiled code must not write
_MARK = 12345


def guarded(memory: NDArray[Any]) -> tuple[NDArray[Any], Callable[[], bool]]:
    """Return a copy of an array with guard values on both sides, and a function that checks them.

    Compiled code does not check indices, so only a changed guard value shows a write outside of the array.
    """
    whole = np.full(len(memory) + 2 * GUARD, _MARK, dtype=memory.dtype)
    inside = whole[GUARD : GUARD + len(memory)]
    inside[:] = memory
    outside = np.r_[0:GUARD, GUARD + len(memory) : len(whole)]
    return inside, lambda: bool((whole[outside] == _MARK).all())


def allocations(run: Callable[[], object]) -> int:
    """Return the number of heap allocations of compiled code while `run` is called; 0 if compilation is disabled.

    Each array argument counts as one allocation. If the number is the same for more ticks, a tick allocates nothing.
    """
    if numba.config.DISABLE_JIT:
        return 0
    return count_allocations(run)
