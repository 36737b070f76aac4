"""Compute the median of part of an array in compiled code that allocates nothing."""

import numpy as np
from numba import types
from numpy.typing import NDArray

from rig.realtime.kernel import kernel

Floats = NDArray[np.float64]

_SCRATCH_TYPE = types.float64[::1]


@kernel(
    types.int64(_SCRATCH_TYPE, types.int64, types.int64, types.float64, types.boolean),
    inline=True,
    no_refcount=True,
)
def _partition(values: Floats, low: int, high: int, pivot: float, equal: bool) -> int:
    """Move values below the pivot (and equal values if `equal`) to the front; return the index after the moved ones."""
    front = low
    for i in range(low, high):
        value = values[i]
        values[i] = values[front]
        values[front] = value
        front += value < pivot or (equal and value == pivot)
    return front


@kernel(types.float64(_SCRATCH_TYPE, types.int64), no_refcount=True)
def median(values: Floats, count: int) -> float:
    """Return the median of the first `count` values by Hoare's selection, which changes their order."""
    middle = count // 2
    low, high = 0, count  # the element of rank `middle` lies in low … high - 1
    draw = 1
    while high - low > 1:
        # A pivot from random values: with fixed ones a regular oscillation would make the time quadratic.
        a = b = c = values[low]
        for _ in range(3):
            draw = (draw * 1103515245 + 12345) & 0x7FFFFFFF  # the generator of C's rand
            a, b, c = b, c, values[low + (draw >> 8) % (high - low)]
        pivot = max(min(a, b), min(max(a, b), c))
        below = _partition(values, low, high, pivot, False)
        if middle < below:
            high = below
            continue
        upto = _partition(values, below, high, pivot, True)
        if middle < upto or upto == low:  # it is the pivot, or (with NaN) nothing can be ordered
            break
        low = upto
    upper = values[middle]
    if count % 2:
        return float(upper)
    lower = values[0]
    for i in range(1, middle):
        lower = max(lower, values[i])
    return float(0.5 * (lower + upper))
