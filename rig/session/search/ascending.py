"""The rule of Koul et al., section III: from the softest wall upwards until one is not stable; so often.

Every stable verdict on the way is a chance for a slip to end the climb early, so the rule reads low by more than its
scatter shows, and it costs most hits far below the limit (`rig.session.search.observer` has the numbers).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.core.deferred import stats
from rig.session.search.psychometric import opened
from rig.session.search.rule import Answer, Censored, Estimate, Probe, check_whole, checked_levels, told


@dataclass(frozen=True, slots=True)
class Climb:
    """The last stable level of a climb that has ended.

    A climb on which no wall failed, or already the softest, has its limit beyond the levels (`censored`) and enters
    with the end of them. Below the softest level that is at most this level too much, as 0 would be too little.
    """

    limit: float
    censored: Censored


@dataclass(frozen=True, kw_only=True)
class Ascending:
    """Climbs through all levels; the limit is the mean of the last stable ones.

    It lies above the levels when any climb's does: the mean is then a lower bound. It lies below them only when every
    climb's does: a single one that ends at the softest wall may be a slip, and says nothing of the others.

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
        places, step = self._places(answers)
        return None if len(places) == self.repeats else Probe(self.levels[step], track=len(places))

    def estimate(self, answers: Sequence[Answer]) -> Estimate:
        """Mean over the climbs that have ended, and Student's interval of it, infinite for a single climb."""
        climbs = self.climbs(answers)
        if not climbs:
            return Estimate(
                value=math.nan, low=0.0, high=math.inf, share=math.nan, censored="", hits=len(answers)
            )
        limits = np.array([climb.limit for climb in climbs])
        value, half = float(limits.mean()), math.inf
        if len(limits) > 1:
            half = float(stats.t.ppf(0.975, len(limits) - 1) * limits.std(ddof=1) / math.sqrt(len(limits)))
        sides = {climb.censored for climb in climbs}
        censored: Censored = "above" if "above" in sides else "below" if sides == {"below"} else ""
        low, high = opened(censored, value, max(0.0, value - half), value + half)
        return Estimate(value=value, low=low, high=high, share=math.nan, censored=censored, hits=len(answers))

    def climbs(self, answers: Sequence[Answer]) -> tuple[Climb, ...]:
        """The climbs that have ended."""
        return tuple(self._climb(place) for place in self._places(answers)[0])

    def _climb(self, place: int) -> Climb:
        side: Censored = "below" if place == 0 else "above" if place == len(self.levels) else ""
        return Climb(self.levels[max(place - 1, 0)], side)

    def _places(self, answers: Sequence[Answer]) -> tuple[list[int], int]:
        """Stable levels of each climb that has ended, and the step of the one that has not."""
        places: list[int] = []
        step = 0
        for _, stable in told(answers):
            if stable:
                step += 1
            if not stable or step == len(self.levels):
                places.append(step)
                step = 0
        return places, step
