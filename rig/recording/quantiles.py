"""Quantiles of a sample, with confidence bounds that hold for any distribution.

The r-th smallest of n independent values lies above the q-quantile of the distribution unless at least r of the values
lie below that quantile, and the number of these values is binomial. No tail is fitted. With too few values there is no
bound: an upper bound of p99.9 with 95 % confidence needs 2995 values. Values that come in bursts are not independent,
and their bounds are too tight.

`rig.doctor` and the timing summary of a recording use this module. It must not assume a distribution, nor judge a
value.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from rig.core.deferred import special

CONFIDENCE = 0.95  # of each bound by itself


@dataclass(frozen=True, slots=True)
class Quantile:
    """A quantile of a sample (`value`), and its lower and upper confidence bound (`low`, `high`).

    A bound is None if the sample has too few values.
    """

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class Distribution:
    """Summary of many values: their number, quantiles and maximum.

    Attributes
    ----------
    number
        Number of values.
    p50, p99, p999
        Median, and the values that 99 % and 99.9 % of the values do not exceed.
    maximum
        Largest value.
    bounded
        Highest level (0 … 1) of a quantile that, with 95 % confidence, does not exceed the maximum.
    """

    number: int
    p50: Quantile
    p99: Quantile
    p999: Quantile
    maximum: float
    bounded: float

    @classmethod
    def of(cls, values: ArrayLike) -> Distribution:
        """Return the summary of an array of any shape with at least one value."""
        x = np.sort(np.asarray(values, dtype=np.float64).ravel())
        return cls(
            number=len(x),
            p50=quantile(x, 0.5),
            p99=quantile(x, 0.99),
            p999=quantile(x, 0.999),
            maximum=float(x[-1]),
            bounded=share_bounded_by_largest(len(x)),
        )

    @property
    def almost_all(self) -> float:
        """Upper confidence bound of the 99.9 % quantile; with fewer than 2995 values, the largest value."""
        return self.maximum if self.p999.high is None else self.p999.high


def quantile(ordered: ArrayLike, share: float, confidence: float = CONFIDENCE) -> Quantile:
    """Return a quantile of a sample with its confidence bounds.

    The sample is `ordered`, ascending, with at least one value. `share` is the fraction of values (0 … 1) that do not
    exceed the quantile, `confidence` that of the lower and of the upper bound, each alone (0 … 1).
    """
    sample = np.asarray(ordered)
    number = len(sample)
    low, high = _ranks_of_bounds(number, share, confidence)

    def ranked(rank: int) -> float:  # from 1
        value: float = sample[rank - 1].item()
        return value

    return Quantile(
        value=ranked(max(1, math.ceil(share * number - 1e-9))),
        low=ranked(low) if low >= 1 else None,
        high=ranked(high) if high <= number else None,
    )


# Cached: all stages of a ledger have the same number of ticks.
@lru_cache
def _ranks_of_bounds(number: int, share: float, confidence: float) -> tuple[int, int]:
    low, high = (math.ceil(special.bdtrik(one, number, share)) for one in (1.0 - confidence, confidence))
    return low, high + 1


def share_bounded_by_largest(number: int, confidence: float = CONFIDENCE) -> float:
    """Return the level (0 … 1) of the quantile for which the largest of `number` values is an upper bound."""
    return float((1.0 - confidence) ** (1.0 / number))


def values_needed(share: float, confidence: float = CONFIDENCE) -> int:
    """Return the least number of independent values that give the quantile at level `share` (0 … 1) an upper bound."""
    return math.ceil(math.log(1.0 - confidence) / math.log(share))
