"""The Psi method: ask where the answer is expected to say most about the threshold.

Kontsevich and Tyler, Vision Research 39 (1999), with lapse rate and spread integrated out (Prins 2013). After each
answer the posterior over (K50, spread, lapse rate) is known; for every level, what either answer would leave of the
entropy of K50 is computed, and the level with the least expected entropy is asked next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import ConfigError
from rig.session.search import _psychometric as psychometric
from rig.session.search._resolution import step_at
from rig.session.search._rule import (
    Estimate,
    JudgedProbe,
    Probe,
    check_whole,
    checked_levels,
    mark_contradictions,
    verdicts_of,
)


@dataclass(frozen=True, kw_only=True)
class Psi:
    """Bayesian search for K50.

    Parameters
    ----------
    levels
        Stiffnesses, rising.
    hits
        Verdicts that are enough in any case.
    enough
        Half width of the 95 % interval, relative to K50, that is enough before; 0: always all hits.
    least
        Verdicts before `enough` may end it.
    seed
        Not used: the rule draws nothing.
    """

    levels: Sequence[float]
    hits: int = 25
    enough: float = 0.0
    least: int = 10
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", checked_levels(self.levels))
        check_whole("hits", self.hits, 1, 10_000)
        check_whole("least", self.least, 1, 10_000)
        if not 0.0 <= self.enough < 1.0:
            raise ConfigError(
                f"enough = {self.enough:g} is outside 0 … 1", remedy="choose a share of K50, like 0.05"
            )

    def next(self, answers: Sequence[JudgedProbe]) -> Probe | None:
        """Return the level whose answer is expected to leave the least entropy of K50."""
        verdicts = verdicts_of(answers)
        if len(verdicts) >= self.hits or self._knows_enough(answers, len(verdicts)):
            return None
        grid = psychometric.of_levels(tuple(self.levels))
        posterior = grid.posterior(verdicts)
        # For every level, what either answer would leave of the entropy of K50: the least expected entropy is asked
        # next.
        stable = np.einsum("ltsg,tsg->lt", grid.shares, posterior)  # jointly with K50, for each level
        other = posterior.sum(axis=(1, 2)) - stable
        expected = _entropy(stable) + _entropy(other)
        return Probe(self.levels[int(np.argmin(expected))])

    def _knows_enough(self, answers: Sequence[JudgedProbe], hits: int) -> bool:
        if self.enough == 0.0 or hits < self.least:
            return False
        estimate = self.estimate(answers)
        return (estimate.high - estimate.low) / 2.0 <= self.enough * estimate.value

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return the posterior median and interval of K50."""
        return posterior_estimate(tuple(self.levels), answers)


def posterior_estimate(levels: tuple[float, ...], answers: Sequence[JudgedProbe]) -> Estimate:
    """Return K50 after any answers on these levels, see `rig.session.search._psychometric.locate`."""
    verdicts = verdicts_of(answers)
    found = psychometric.locate(levels, verdicts)
    estimate = Estimate(
        value=found.value,
        low=found.low,
        high=found.high,
        share=0.5,
        censored=found.censored,
        hits=len(answers),
        step=step_at(levels, found.value),
    )
    return mark_contradictions(estimate, verdicts)


def _entropy(joint: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the entropy that an answer leaves, weighted by how likely it is: rows of joint probabilities over K50."""
    likely = joint.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.where(joint > 0.0, joint * np.log(joint / likely), 0.0)
    return np.asarray(-terms.sum(axis=1))
