"""The psychometric function of walls, and what answers say of it: a posterior on a grid.

    P(stable | K) = λ + (1 − 2 λ) / (1 + exp((K − K50) / s))

K50 is where half of the verdicts are stable, s the spread, λ the share of slips, as likely one way as the other. The
posterior is computed on a grid of the three, flat over K50, over log s and over λ: no fit can fail to converge, and a
few answers give a wide interval instead of none. Slips and spread are integrated out (the marginal of Prins, Journal of
Vision 13(7):3, 2013, of the Psi method of Kontsevich and Tyler, Vision Research 39, 1999).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

THRESHOLDS = 121  # K50 from half a range below the levels to half a range above
SPREADS = 9
SLIPS = (0.0, 0.01, 0.02, 0.04, 0.08)
LEAST_SPREAD, MOST_SPREAD = 0.25, 0.25  # of the smallest step; of the whole range


def share_stable(stiffness: Floats | float, threshold: float, spread: float, slips: float = 0.0) -> Floats:
    """Share of stable verdicts at a stiffness."""
    odds = np.clip((np.asarray(stiffness, dtype=np.float64) - threshold) / spread, -700.0, 700.0)
    return np.asarray(slips + (1.0 - 2.0 * slips) / (1.0 + np.exp(odds)))


@dataclass(frozen=True)
class Psychometric:
    """The grid for a set of levels (stiffnesses, rising). `log_share` is made once for all levels."""

    levels: tuple[float, ...]

    @cached_property
    def thresholds(self) -> Floats:
        """Values of K50, shape (THRESHOLDS,)."""
        low, high = self.levels[0], self.levels[-1]
        half = (high - low) / 2.0
        return np.linspace(max(low - half, 1e-3 * low), high + half, THRESHOLDS)

    @cached_property
    def spreads(self) -> Floats:
        """Values of s, shape (SPREADS,)."""
        least = LEAST_SPREAD * np.diff(self.levels).min()
        return np.geomspace(
            least, max(MOST_SPREAD * (self.levels[-1] - self.levels[0]), 2.0 * least), SPREADS
        )

    @cached_property
    def shares(self) -> Floats:
        """Share of stable verdicts, shape (levels, THRESHOLDS, SPREADS, slips)."""
        level = np.array(self.levels)[:, None, None, None]
        slips = np.array(SLIPS)
        odds = (level - self.thresholds[:, None, None]) / self.spreads[:, None]
        return np.asarray(slips + (1.0 - 2.0 * slips) / (1.0 + np.exp(np.clip(odds, -700.0, 700.0))))

    @cached_property
    def logs(self) -> tuple[Floats, Floats]:
        """Logarithms of the shares of stable and of other verdicts."""
        with np.errstate(divide="ignore"):
            return np.log(self.shares), np.log1p(-self.shares)

    def posterior(self, verdicts: Sequence[tuple[float, bool]]) -> Floats:
        """Probability of each grid point after these verdicts (level, stable), shape as one level of `shares`."""
        stable, other = self.logs
        log = np.zeros(self.shares.shape[1:])
        for level, verdict in verdicts:
            place = self.levels.index(level)
            log = log + (stable if verdict else other)[place]
        weights = np.exp(log - log.max())
        return np.asarray(weights / weights.sum())

    def quantiles(self, posterior: Floats, share: float, probabilities: Sequence[float]) -> Floats:
        """Quantiles of the stiffness at which `share` of a slipless observer's verdicts are stable."""
        at = self.thresholds[:, None] + self.spreads * np.log((1.0 - share) / share)
        weights = posterior.sum(axis=2)
        order = np.argsort(at, axis=None)
        below = np.cumsum(weights.reshape(-1)[order])
        return np.asarray(np.interp(np.asarray(probabilities) * below[-1], below, at.reshape(-1)[order]))

    def mean(self, posterior: Floats) -> float:
        """Posterior mean of K50."""
        return float(posterior.sum(axis=(1, 2)) @ self.thresholds)


@lru_cache(maxsize=16)
def of_levels(levels: tuple[float, ...]) -> Psychometric:
    """The grid for these levels, made once."""
    return Psychometric(levels)


def interval(
    levels: tuple[float, ...], verdicts: Sequence[tuple[float, bool]], share: float
) -> tuple[float, float]:
    """Interval of 95 % for the stiffness with this share of stable verdicts, whatever rule asked for them."""
    grid = of_levels(levels)
    low, high = grid.quantiles(grid.posterior(verdicts), share, (0.025, 0.975))
    return float(low), float(high)
