"""Grid search rule: every level equally often, in random order (the method of constant stimuli).

This rule needs the most trials and the fewest assumptions: it also detects walls that do not follow a threshold, such
as stiff walls that are stable although softer walls are not. A protocol selects it by ``search.rule = "grid"``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.session.search._psi import posterior_estimate
from rig.session.search._rule import Estimate, JudgedProbe, Probe, check_whole, checked_levels, verdicts_of


@dataclass(frozen=True, kw_only=True)
class LevelGrid:
    """Search rule that presents all levels (stiffnesses) `repeats` times, each time in a new random order (`seed`)."""

    levels: Sequence[float]
    repeats: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", checked_levels(self.levels))
        check_whole("repeats", self.repeats, 1, 1000)

    def next(self, answers: Sequence[JudgedProbe]) -> Probe | None:
        """Return the next wall of the random order in which all levels are presented; None after the last wall."""
        done = len(verdicts_of(answers))
        if done >= self.repeats * len(self.levels):
            return None
        block, place = divmod(done, len(self.levels))
        order = np.random.default_rng([self.seed, block]).permutation(len(self.levels))
        return Probe(self.levels[int(order[place])], track=block)

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return the estimate of K50 (the stiffness at which half of the verdicts are stable) with a 95 % interval."""
        return posterior_estimate(tuple(self.levels), answers)
