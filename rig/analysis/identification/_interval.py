"""A value with its 95 % confidence interval, computed with Student's distribution."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rig.core.deferred import special

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Interval:
    """A value and the half width `ci95` of its 95 % confidence interval, in the same unit; infinite if unknown.

    `from_scatter` and `from_left_out` cover scatter only, not an error that is equal in all realisations.
    """

    value: float
    ci95: float

    @property
    def low(self) -> float:
        """Return the lower end of the 95 % interval, in the unit of the value."""
        return self.value - self.ci95

    @property
    def high(self) -> float:
        """Return the upper end of the 95 % interval, in the unit of the value."""
        return self.value + self.ci95

    def holds(self, value: float) -> bool:
        """Return True if `value` lies within this 95 % interval."""
        return self.low <= value <= self.high

    def scaled(self, factor: float) -> Interval:
        """Return the 95 % interval of `factor` times this value."""
        return Interval(factor * self.value, abs(factor) * self.ci95)

    def text(self, unit: str = "") -> str:
        """Return a text like ``1.25 ± 0.12 kg``: value, half width of the interval with two digits, and unit."""
        return f"{_shown(self.value, self.ci95)} {unit}".rstrip()


def quantile(degrees_of_freedom: float) -> float:
    """Return the two-sided 95 % quantile of Student's distribution; infinite below one degree of freedom."""
    if degrees_of_freedom < 1:
        return math.inf
    return float(special.stdtrit(degrees_of_freedom, 0.5 + 0.5 * CONFIDENCE))


def from_scatter(value: float, samples: ArrayLike) -> Interval:
    """Return the 95 % interval of a value that is fitted to several realisations of an experiment.

    `value` is fitted to all realisations together, each of `samples` to one realisation.
    """
    each = np.asarray(samples, dtype=np.float64)
    if len(each) < 2:
        return Interval(value, math.inf)
    return Interval(value, quantile(len(each) - 1) * float(each.std(ddof=1)) / math.sqrt(len(each)))


def from_left_out(value: float, others: ArrayLike) -> Interval:
    """Return the 95 % interval of `value`, fitted to all realisations; `others` omit one each (jackknife)."""
    # Fits to single realisations scatter more than their number explains where the motion is a few counts.
    less = np.asarray(others, dtype=np.float64)
    return from_scatter(value, len(less) * value - (len(less) - 1) * less)


def _shown(value: float, ci95: float) -> str:
    if not math.isfinite(ci95) or ci95 <= 0.0:
        return f"{value:.4g}"
    exponent = math.floor(math.log10(max(abs(value), ci95)))
    digits = max(0, exponent - math.floor(math.log10(ci95)) + 1)
    if -3 <= exponent < 5:
        places = max(0, digits - exponent)
        return f"{value:.{places}f} ± {ci95:.{places}f}"
    return f"({value / 10**exponent:.{digits}f} ± {ci95 / 10**exponent:.{digits}f})e{exponent:+03d}"
