"""Ascending search rule of Koul et al., section III: raise the stiffness until a wall is not stable, then start again.

A lapse (a wrong verdict by mistake) at any stable wall below the limit ends the series early. Estimates are therefore
too low by more than their scatter shows, and most hits are far below the limit (numbers in ``README.md``). A protocol
selects it by ``search.rule = "ascending"``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.core.deferred import stats
from rig.session.search._psychometric import open_interval
from rig.session.search._resolution import is_resolved, rounding_deviation, step_at
from rig.session.search._rule import (
    Censored,
    Estimate,
    JudgedProbe,
    Probe,
    check_whole,
    checked_levels,
    mark_contradictions,
    verdicts_of,
)


@dataclass(frozen=True, slots=True)
class AscendingSeries:
    """Result of one ascending series (stiffer walls until one is not stable): the last stable stiffness, as `limit`.

    `censored` is "above" or "below" if all walls, or none, were stable.
    """

    limit: float
    censored: Censored


@dataclass(frozen=True, kw_only=True)
class Ascending:
    """Search rule: ascending series through all levels; the limit is the mean of the last stable levels of the series.

    If any series ends above the levels, the limit is reported as above the levels, and the mean is a lower bound. The
    limit is reported as below the levels only if every series ends below the levels, because a single one may be a
    lapse (a wrong verdict by mistake).

    Parameters
    ----------
    levels
        Stiffnesses in ascending order.
    repeats
        Number of series.
    seed
        Not used, because this rule is not random; accepted so that all rules have the same arguments.
    """

    levels: Sequence[float]
    repeats: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", checked_levels(self.levels))
        check_whole("repeats", self.repeats, 1, 1000)

    def next(self, answers: Sequence[JudgedProbe]) -> Probe | None:
        """Return the next stiffer wall of the ascending series, or the first wall of a new one; None after the last."""
        places, step = self._places(answers)
        return None if len(places) == self.repeats else Probe(self.levels[step], track=len(places))

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return the mean of the last stable levels of all finished series, with a 95 % interval (Student's t).

        The interval is infinite for a single series, and for series that scatter no more than rounding to levels
        explains. If such series end beyond the levels (censored), the last level bounds the interval on one side.
        """
        series = self.series(answers)
        if not series:
            return Estimate(
                value=math.nan, low=0.0, high=math.inf, share=math.nan, censored="", hits=len(answers)
            )
        limits = np.array([one.limit for one in series])
        sides = {one.censored for one in series}
        censored: Censored = "above" if "above" in sides else "below" if sides == {"below"} else ""
        value, half = float(limits.mean()), math.inf
        step = step_at(self.levels, value)
        deviation = float(limits.std(ddof=1)) if len(limits) > 1 else math.nan
        if is_resolved(deviation, rounding_deviation(step)):
            half = float(stats.t.ppf(0.975, len(limits) - 1) * deviation / math.sqrt(len(limits)))
        elif len(limits) > 1 and censored:
            half = 0.0
        low, high = open_interval(censored, value, max(0.0, value - half), value + half)
        estimate = Estimate(
            value=value, low=low, high=high, share=math.nan, censored=censored, hits=len(answers), step=step
        )
        return mark_contradictions(estimate, verdicts_of(answers))

    def series(self, answers: Sequence[JudgedProbe]) -> tuple[AscendingSeries, ...]:
        """Return the results of the finished ascending series, in the order in which they were presented."""
        return tuple(self._series(place) for place in self._places(answers)[0])

    def _series(self, place: int) -> AscendingSeries:
        side: Censored = "below" if place == 0 else "above" if place == len(self.levels) else ""
        return AscendingSeries(self.levels[max(place - 1, 0)], side)

    def _places(self, answers: Sequence[JudgedProbe]) -> tuple[list[int], int]:
        """Return the number of stable walls in each finished ascending series, and the number in the unfinished one."""
        places: list[int] = []
        step = 0
        for _, stable in verdicts_of(answers):
            if stable:
                step += 1
            # Every stable verdict on the way is a chance for a lapse to end the series early: the rule reads low by
            # more than its scatter shows (README.md has the numbers).
            if not stable or step == len(self.levels):
                places.append(step)
                step = 0
        return places, step
