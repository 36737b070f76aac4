"""Quantiles of a sample with bounds that hold for any distribution.

The r-th smallest of N independent values lies above the q-quantile of their distribution unless r of them lie below it,
and how many do is binomial. So an order statistic is a bound of known confidence, whatever the distribution: no tail is
fitted. With too few values there is none: of a p99.9 an upper bound at 95 % needs 2995 of them. What N values do bound
is said then.

Round trips come in bursts, so that they are not quite independent: a measurement that lasts longer is worth more than
one that asks faster.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

CONFIDENCE = 0.95  # of each bound by itself


@dataclass(frozen=True, slots=True)
class Quantile:
    """A quantile of a sample, and one-sided bounds for that of the distribution (None: too few values)."""

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class Distribution:
    """What is kept of many times (s).

    Attributes
    ----------
    number
        How many.
    p50, p99, p999
        Median, and what 99 % and 99.9 % do not exceed.
    maximum
        Largest value.
    bounded
        The maximum is an upper bound for this quantile (0 … 1), with the confidence of all bounds.
    """

    number: int
    p50: Quantile
    p99: Quantile
    p999: Quantile
    maximum: float
    bounded: float

    @classmethod
    def of(cls, values: ArrayLike) -> Distribution:
        """Sort at least one value."""
        x = np.sort(np.asarray(values, dtype=np.float64).ravel())
        return cls(
            number=len(x),
            p50=quantile(x, 0.5),
            p99=quantile(x, 0.99),
            p999=quantile(x, 0.999),
            maximum=float(x[-1]),
            bounded=bounded_by_the_largest(len(x)),
        )

    @property
    def almost_all(self) -> float:
        """Upper bound for p99.9 where there is one, else the largest value seen (s)."""
        return self.maximum if self.p999.high is None else self.p999.high

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


def quantile(ordered: ArrayLike, q: float, confidence: float = CONFIDENCE) -> Quantile:
    """Quantile `q` of ascending values, the least that a share q does not exceed, with its bounds."""
    from scipy.special import betainc  # noqa: PLC0415

    x = np.asarray(ordered, dtype=np.float64)
    n = len(x)
    rank = np.arange(n, dtype=np.float64)
    at_most = betainc(n - rank, rank + 1.0, 1.0 - q)  # P(no more than so many of n lie below the quantile)
    above = np.flatnonzero(at_most >= confidence)
    below = np.flatnonzero(1.0 - at_most >= confidence)
    return Quantile(
        value=float(x[max(0, math.ceil(q * n * (1.0 - 1e-12)) - 1)]),
        low=float(x[below[-1]]) if len(below) else None,
        high=float(x[above[0]]) if len(above) else None,
    )


def bounded_by_the_largest(number: int, confidence: float = CONFIDENCE) -> float:
    """Quantile for which the largest of so many values is an upper bound."""
    return float((1.0 - confidence) ** (1.0 / number))


def values_needed(q: float, confidence: float = CONFIDENCE) -> int:
    """How many values an upper bound for quantile `q` needs."""
    return math.ceil(math.log(1.0 - confidence) / math.log(q))
