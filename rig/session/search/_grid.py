"""The full grid: every level so often, in an order drawn from the seed (the method of constant stimuli).

It costs most and assumes least: also a limit that is no threshold shows, such as stiff walls that hold where softer
ones do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.session.search._psi import posterior_estimate
from rig.session.search._rule import Estimate, JudgedProbe, Probe, check_whole, checked_levels, verdicts_of


@dataclass(frozen=True, kw_only=True)
class LevelGrid:
    """Every level `repeats` times, each time all levels in another order (`seed`)."""

    levels: Sequence[float]
    repeats: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", checked_levels(self.levels))
        check_whole("repeats", self.repeats, 1, 1000)

    def next(self, answers: Sequence[JudgedProbe]) -> Probe | None:
        """Return the next level of the order."""
        done = len(verdicts_of(answers))
        if done >= self.repeats * len(self.levels):
            return None
        block, place = divmod(done, len(self.levels))
        order = np.random.default_rng([self.seed, block]).permutation(len(self.levels))
        return Probe(self.levels[int(order[place])], track=block)

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return K50 of the psychometric function that the verdicts show."""
        return posterior_estimate(tuple(self.levels), answers)
