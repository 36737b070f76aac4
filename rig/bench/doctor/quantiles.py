"""Quantiles of a sample with bounds that hold for any distribution (`rig.recording.quantiles`).

Round trips come in bursts, so that they are not quite independent: a measurement that lasts longer is worth more than
one that asks faster. With too few values for a bound, it is said which quantile they do bound.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rig.recording.quantiles import quantile_ranks

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
    x = np.asarray(ordered, dtype=np.float64)
    rank, low, high = quantile_ranks(len(x), q, confidence)
    return Quantile(
        value=float(x[rank - 1]),
        low=None if low is None else float(x[low - 1]),
        high=None if high is None else float(x[high - 1]),
    )


def bounded_by_the_largest(number: int, confidence: float = CONFIDENCE) -> float:
    """Quantile for which the largest of so many values is an upper bound."""
    return float((1.0 - confidence) ** (1.0 / number))


def values_needed(q: float, confidence: float = CONFIDENCE) -> int:
    """How many values an upper bound for quantile `q` needs."""
    return math.ceil(math.log(1.0 - confidence) / math.log(q))
