"""The rule of Koul et al., section III: from the softest wall upwards until one is not stable; so often.

Every stable verdict on the way is a chance for a slip to end the climb early, so the rule reads low by more than its
scatter shows, and it costs most hits far below the limit (`rig.search.observer` has the numbers).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.search.rule import Answer, Censored, Estimate, Probe, check_whole, checked_levels, told


@dataclass(frozen=True, kw_only=True)
class Ascending:
    """Climbs through all levels; the limit is the mean of the last stable ones.

    Parameters
    ----------
    levels
        Stiffnesses, rising.
    repeats
        Climbs.
    seed
        Not used: the rule draws nothing. Taken, so that all rules are made alike.
    """

    levels: Sequence[float]
    repeats: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", checked_levels(self.levels))
        check_whole("repeats", self.repeats, 1, 1000)

    def next(self, answers: Sequence[Answer]) -> Probe | None:
        """The next level of the climb, or the first one of the next."""
        limits, step = self._climbs(answers)
        return None if len(limits) == self.repeats else Probe(self.levels[step], track=len(limits))

    def estimate(self, answers: Sequence[Answer]) -> Estimate:
        """Mean over the climbs that have ended, and Student's interval of it, infinite for a single climb."""
        from scipy import stats  # noqa: PLC0415

        places = np.array(self._climbs(answers)[0])
        if len(places) == 0:
            return Estimate(
                value=math.nan, low=0.0, high=math.inf, share=math.nan, censored="", hits=len(answers)
            )
        limits = np.array((0.0, *self.levels))[places]
        half = math.inf
        if len(limits) > 1:
            half = float(stats.t.ppf(0.975, len(limits) - 1) * limits.std(ddof=1) / math.sqrt(len(limits)))
        return Estimate(
            value=float(limits.mean()),
            low=max(0.0, float(limits.mean()) - half),
            high=float(limits.mean()) + half,
            share=math.nan,
            censored=self._censored(places),
            hits=len(answers),
        )

    def _climbs(self, answers: Sequence[Answer]) -> tuple[list[int], int]:
        """Stable levels of each climb that has ended, and the step of the one that has not."""
        limits: list[int] = []
        step = 0
        for _, stable in told(answers):
            if stable:
                step += 1
            if not stable or step == len(self.levels):
                limits.append(step)
                step = 0
        return limits, step

    def _censored(self, places: np.ndarray) -> Censored:
        if (places == len(self.levels)).any():
            return "above"
        return "below" if (places == 0).any() else ""
