"""The Psi method: present the wall whose verdict is expected to give the most information about the threshold K50.

Kontsevich and Tyler, Vision Research 39 (1999), with lapse rate and spread integrated out (Prins 2013). After each
answer the posterior over (K50, spread, lapse rate) is updated. The next level is the one with the least expected
entropy of K50 after its verdict. A protocol selects it by ``search.rule = "psi"``.
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
    """Bayesian search rule for K50, the stiffness at which half of the verdicts are stable.

    Parameters
    ----------
    levels
        Stiffnesses in ascending order.
    hits
        Number of verdicts after which the search ends.
    enough
        Half width of the 95 % interval, relative to K50, at which the search ends earlier; 0: never.
    least
        Least number of verdicts before `enough` can end the search.
    seed
        Not used, because this rule is not random.
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
                f"enough = {self.enough:g} must be at least 0 and below 1",
                remedy="give the half width of the confidence interval at which the search stops, as a share of K50 "
                "(the stiffness with 50 % 'stable' answers), like 0.05; with 0 the search uses all hits",
            )

    def next(self, answers: Sequence[JudgedProbe]) -> Probe | None:
        """Return the wall whose verdict gives the least expected entropy of K50; None if the search is finished.

        K50 is the stiffness at which half of the verdicts are stable.
        """
        verdicts = verdicts_of(answers)
        if len(verdicts) >= self.hits or self._knows_enough(answers, len(verdicts)):
            return None
        grid = psychometric.of_levels(tuple(self.levels))
        posterior = grid.posterior(verdicts)

        # For each level, the joint probability of "stable" and each K50; the next wall has the least expected entropy.
        stable = np.einsum("ltsg,tsg->lt", grid.shares, posterior)
        other = posterior.sum(axis=(1, 2)) - stable
        expected = _entropy(stable) + _entropy(other)
        return Probe(self.levels[int(np.argmin(expected))])

    def _knows_enough(self, answers: Sequence[JudgedProbe], hits: int) -> bool:
        if self.enough == 0.0 or hits < self.least:
            return False
        estimate = self.estimate(answers)
        return (estimate.high - estimate.low) / 2.0 <= self.enough * estimate.value

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return the posterior median of K50 (stiffness with half of the verdicts stable) with a 95 % interval."""
        return posterior_estimate(tuple(self.levels), answers)


def posterior_estimate(levels: tuple[float, ...], answers: Sequence[JudgedProbe]) -> Estimate:
    """Return the posterior median of K50 (stiffness with half of the verdicts stable) with its 95 % interval."""
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
    """Return for each row the entropy of K50 after a verdict, times the probability of the verdict.

    Each row of `joint` contains the joint probabilities of the verdict and each value of K50 (the limit of stable
    walls).
    """
    likely = joint.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.where(joint > 0.0, joint * np.log(joint / likely), 0.0)
    return np.asarray(-terms.sum(axis=1))
