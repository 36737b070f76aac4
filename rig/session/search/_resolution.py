"""Decide if values scatter more than rounding to the tested levels explains; else no interval or p value is computed.

For means over n independent searches, the caller divides the rounding error by √n. Search rules and the analysis of
studies use it.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

# Relative; sums of the same numbers in another order differ by less.
FLOATING = 1e-9


def step_at(levels: Sequence[float], value: float) -> float:
    """Return the distance of the two levels (tested stiffnesses) around `value`, or of the nearest two beyond them."""
    place = min(max(bisect_right(levels, value), 1), len(levels) - 1)
    return levels[place] - levels[place - 1]


def rounding_deviation(step: float) -> float:
    """Return the standard deviation of the rounding to levels (tested stiffnesses) that are `step` apart."""
    # A search rounds its limit to the distance of two levels. Values that scatter by less do not show how much people
    # vary: three differences of exactly 30 on levels 10 apart once gave 30 (29.99 … 30.01), p < 0.001.
    return step / math.sqrt(12.0)


def is_resolved(deviation: float, rounding: float = 0.0, magnitude: float = 0.0) -> bool:
    """Return True if a standard deviation is larger than rounding to the tested levels of stiffness explains.

    `deviation` is that of values or of a residual; if it is not finite, the result is False. `rounding` is the standard
    deviation of the rounding of each value to levels, 0 for continuous values. `magnitude` is the magnitude of the
    largest value, for the rounding of floating-point numbers.
    """
    return math.isfinite(deviation) and deviation > max(rounding * (1.0 + FLOATING), FLOATING * magnitude)


def unresolved_words(what: str, deviation: float, rounding: float) -> str:
    """Return a sentence that explains why the values `what` get no interval and no p value.

    `deviation` is their standard deviation, and `rounding` that of their rounding to levels (0: continuous values).
    """
    if rounding == 0.0:
        return f"{what} are equal, so their scatter is unknown: no interval and no p value"
    return (
        f"{what} have a standard deviation of {deviation:.3g}, not larger than rounding to levels gives "
        f"({rounding:.3g}): no interval and no p value"
    )
