"""Psychometric function (probability of a stable verdict over stiffness), and its posterior from verdicts, on a grid.

    P(stable | K) = λ + (1 − 2 λ) / (1 + exp((K − K50) / s))

At the stiffness K50 half of the verdicts are stable. s is the spread: how gradually verdicts change with stiffness. λ
is the lapse rate: the fraction of verdicts that are inverted by mistake, equally likely in both directions. Spread and
lapse rate are integrated out (the marginal of Prins, Journal of Vision 13(7):3, 2013, of the Psi method of Kontsevich
and Tyler, Vision Research 39, 1999). Search rules and the analysis of studies use it. It must not draw random numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from rig.session.search._rule import Censored

Floats = NDArray[np.float64]

LEAST_THRESHOLDS, MOST_THRESHOLDS = 121, 241  # values of K50
# of the smallest step, from value to value: coarser ones miss steep observers between two levels
FINENESS = 0.4
SPREADS = 10
LAPSE_RATES = (0.0, 0.01, 0.02, 0.04, 0.08)
LEAST_SPREAD = 0.25  # of the smallest step
# Relative to the range of levels; with 0.25, the posterior of an observer with gradual verdicts was too narrow.
MOST_SPREAD = 0.35


def share_stable(
    stiffness: Floats | float, threshold: float, spread: float, lapse_rate: float = 0.0
) -> Floats:
    """Return the expected fraction of stable verdicts at a stiffness.

    `threshold` is the stiffness with half of the verdicts stable (K50), and `spread` states how gradually verdicts
    change with stiffness (both in the unit of stiffness).
    """
    odds = np.clip((np.asarray(stiffness, dtype=np.float64) - threshold) / spread, -700.0, 700.0)
    return np.asarray(lapse_rate + (1.0 - 2.0 * lapse_rate) / (1.0 + np.exp(odds)))


# A grid, not a fit: nothing can fail to converge, and a few answers give a wide interval instead of none.
@dataclass(frozen=True)
class PsychometricGrid:
    """Grid of the parameters of the psychometric function (probability of a stable verdict over stiffness).

    The parameters are K50 (stiffness with half of the verdicts stable), spread and lapse rate. `levels` are the tested
    stiffnesses, ascending.
    """

    levels: tuple[float, ...]

    @cached_property
    def edges(self) -> Floats:
        """Edges of the cells around the grid's values of K50 (stiffness with half of the verdicts stable)."""
        # Flat over K50 where levels are a step apart, over log K50 where they are a ratio apart, from half a range
        # below them to half a range above: a limit is as likely between any two levels as between any other two.
        if _ratio_apart(self.levels):
            return np.asarray(np.exp(_edges(np.log(self.levels), -math.inf)))
        return _edges(np.array(self.levels), 0.0)

    @cached_property
    def thresholds(self) -> Floats:
        """The grid's values of K50 (stiffness with half of the verdicts stable), shape (thresholds,)."""
        return np.asarray((self.edges[:-1] + self.edges[1:]) / 2.0)

    @cached_property
    def spreads(self) -> Floats:
        """Spreads on the grid (how gradually verdicts change with stiffness, in units of it), shape (spreads,)."""
        # Flat over log s.
        least = LEAST_SPREAD * np.diff(self.levels).min()
        return np.geomspace(
            least, max(MOST_SPREAD * (self.levels[-1] - self.levels[0]), 2.0 * least), SPREADS
        )

    @cached_property
    def shares(self) -> Floats:
        """Probability of a stable verdict at each grid point, shape (levels, thresholds, spreads, lapse rates)."""
        level = np.array(self.levels)[:, None, None, None]
        lapses = np.array(LAPSE_RATES)
        odds = (level - self.thresholds[:, None, None]) / self.spreads[:, None]
        return np.asarray(lapses + (1.0 - 2.0 * lapses) / (1.0 + np.exp(np.clip(odds, -700.0, 700.0))))

    @cached_property
    def logs(self) -> tuple[Floats, Floats]:
        """Natural logarithms of the probability of a stable verdict at each grid point, and of one minus it."""
        with np.errstate(divide="ignore"):
            return np.log(self.shares), np.log1p(-self.shares)

    @cached_property
    def _latest(self) -> list[tuple[tuple[tuple[float, bool], ...], Floats]]:
        # The last verdicts and their log likelihood, because the next call mostly adds one verdict.
        return [((), np.zeros(self.shares.shape[1:]))]

    def posterior(self, verdicts: Sequence[tuple[float, bool]]) -> Floats:
        """Return the posterior probability of each grid point, shape (thresholds, spreads, lapse rates)."""
        known, log = self._latest[0]
        # A correction changed earlier verdicts, so the cached log likelihood is not valid.
        if tuple(verdicts[: len(known)]) != known:
            known, log = (), np.zeros(self.shares.shape[1:])
        stable, other = self.logs
        for level, verdict in verdicts[len(known) :]:
            log = log + (stable if verdict else other)[self.levels.index(level)]
        self._latest[0] = tuple(verdicts), log
        weights = np.exp(log - log.max())
        return np.asarray(weights / weights.sum())

    def quantiles(self, posterior: Floats, share: float, probabilities: Sequence[float]) -> Floats:
        """Return quantiles of the stiffness at which the fraction `share` of verdicts is stable; at least 0.

        `posterior` is the probability of each grid point, `probabilities` are the levels of the quantiles (0 … 1). The
        stiffness is that of an observer without lapses.
        """
        shifts = self.spreads * math.log((1.0 - share) / share)
        # The probability of each K50 is spread over its cell: after some dozens of verdicts a cell is not small
        # compared with the uncertainty, and intervals between grid points would be too narrow.
        # The distribution function is linear between these points.
        at = np.unique(self.edges + shifts[:, None])
        below = np.zeros(len(at))
        for shift, weights in zip(shifts, posterior.sum(axis=2).T, strict=True):
            below += np.interp(at, self.edges + shift, np.concatenate(([0.0], np.cumsum(weights))))
        return np.asarray(np.maximum(np.interp(np.asarray(probabilities) * below[-1], below, at), 0.0))


@lru_cache(maxsize=16)
def of_levels(levels: tuple[float, ...]) -> PsychometricGrid:
    """Return the psychometric function's grid for these levels (stiffnesses, ascending), from a cache."""
    return PsychometricGrid(levels)


@dataclass(frozen=True, slots=True, kw_only=True)
class Located:
    """Stiffness estimated from verdicts (`value`), with its 95 % interval (`low`, `high`).

    If the stiffness lies above or below all levels (`censored`), `value` is the last level, and the interval extends to
    infinity or to 0.
    """

    value: float
    low: float
    high: float
    censored: Censored


def locate(levels: tuple[float, ...], verdicts: Sequence[tuple[float, bool]], share: float = 0.5) -> Located:
    """Return the stiffness at which the fraction `share` of verdicts is stable, with a 95 % interval.

    `verdicts` are pairs of a level and True for stable, from any search rule. The value is the posterior median. It is
    censored if the median lies beyond the levels, or if all verdicts are equal (the value is then the last judged
    level).
    """
    if not verdicts:
        return Located(value=math.nan, low=0.0, high=math.inf, censored="")
    grid = of_levels(levels)
    # The median, not the mean: after few verdicts the only one that was not stable may have been a lapse, and the
    # posterior's long tail upwards pulls the mean along.
    low, middle, high = (
        float(one) for one in grid.quantiles(grid.posterior(verdicts), share, (0.025, 0.5, 0.975))
    )
    kinds, judged = {stable for _, stable in verdicts}, [level for level, _ in verdicts]
    side: Censored = ""
    end = middle
    if kinds == {True} or middle > levels[-1]:
        side, end = "above", levels[-1] if False in kinds else max(judged)
    elif kinds == {False} or middle < levels[0]:
        side, end = "below", levels[0] if True in kinds else min(judged)
    low, high = open_interval(side, end, low, high)
    return Located(value=end, low=low, high=high, censored=side)


def open_interval(side: Censored, end: float, low: float, high: float) -> tuple[float, float]:
    """Return an interval extended to infinity (`side` "above") or to 0 ("below"); unchanged if `side` is "".

    It is extended if the estimated stiffness lies beyond the levels, and contains `end`, the last level on that side.
    """
    if side == "above":
        return min(low, end), math.inf
    return (0.0, max(high, end)) if side == "below" else (low, high)


def interval(
    levels: tuple[float, ...], verdicts: Sequence[tuple[float, bool]], share: float
) -> tuple[float, float]:
    """Return the 95 % interval of the stiffness at which the fraction `share` of verdicts (level, stable) is stable."""
    grid = of_levels(levels)
    low, high = grid.quantiles(grid.posterior(verdicts), share, (0.025, 0.975))
    return float(low), float(high)


def _edges(levels: Floats, least: float) -> Floats:
    """Return evenly spaced edges, from half a range below the levels, but at least `least`, to half a range above."""
    half = (levels[-1] - levels[0]) / 2.0
    low, high = max(levels[0] - half, least), levels[-1] + half
    wanted = math.ceil((high - low) / (FINENESS * np.diff(levels).min()))
    return np.linspace(low, high, min(max(wanted, LEAST_THRESHOLDS), MOST_THRESHOLDS) + 1)


def _ratio_apart(levels: Sequence[float]) -> bool:
    """Return True if the logarithms of the levels (stiffnesses) are more evenly spaced than the levels themselves."""

    def unevenness(values: Floats) -> float:
        steps = np.diff(values)
        return float(steps.std() / steps.mean())

    return unevenness(np.log(levels)) < unevenness(np.asarray(levels))
