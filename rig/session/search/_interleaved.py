"""Interleaved search rule: two staircases (up-down methods), one from below and one from above, alternating at random.

A person cannot follow a staircase that continues at random times, so a verdict depends more on the wall and less on the
previous verdict. A protocol selects it by ``search.rule = "interleaved"``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rig.session.search import _psychometric as psychometric
from rig.session.search._resolution import step_at
from rig.session.search._rule import Censored, Estimate, JudgedProbe, Probe, mark_contradictions, verdicts_of
from rig.session.search._staircase import Staircase


@dataclass(frozen=True, kw_only=True)
class Interleaved:
    """Search rule: two interleaved staircases, which begin at the softest and at the stiffest level.

    The other settings are those of a single staircase (`Staircase`), for each of the two.

    Parameters
    ----------
    seed
        Seed for the random choice between the two staircases.
    """

    levels: Sequence[float]
    stable_to_rise: int = 1
    steps: Sequence[int] = (4, 2, 1)
    turns: int = 6
    most: int = 40
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", self._staircase.levels)

    @property
    def _staircase(self) -> Staircase:
        return Staircase(
            levels=self.levels,
            stable_to_rise=self.stable_to_rise,
            steps=self.steps,
            turns=self.turns,
            most=self.most,
        )

    @property
    def _tracks(self) -> tuple[Staircase, Staircase]:
        one = self._staircase
        return replace(one, start=one.levels[0]), replace(one, start=one.levels[-1])

    def next(self, answers: Sequence[JudgedProbe]) -> Probe | None:
        """Return the next wall of an unfinished staircase, chosen at random; None if both staircases are finished."""
        probes = [track.next(answers, number) for number, track in enumerate(self._tracks)]
        going = [probe for probe in probes if probe is not None]
        if not going:
            return None
        # A person cannot follow a track whose turn is random, so an answer depends more on the wall and less on the
        # last one.
        drawn = np.random.default_rng([self.seed, len(verdicts_of(answers))])
        return going[int(drawn.integers(len(going)))]

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return the mean of the estimates of the two staircases, with a 95 % interval from all verdicts together."""
        single = [
            track.estimate_of(
                track.walk(verdicts_of(answers, number)), verdicts_of(answers, number), len(answers)
            )
            for number, track in enumerate(self._tracks)
        ]
        share = single[0].share
        low, high = psychometric.interval(tuple(self.levels), verdicts_of(answers), share)
        values = [one.value for one in single if math.isfinite(one.value)]
        value = sum(values) / len(values) if values else math.nan
        censored: Censored = next((one.censored for one in single if one.censored), "")
        low, high = psychometric.open_interval(censored, value, low, high)
        short = [
            f"{one.distrust_reason}, track {number}"
            for number, one in enumerate(single, 1)
            if one.ended_by_most
        ]
        distrust_reason = "; ".join(short)
        if {"above", "below"} <= {one.censored for one in single}:
            distrust_reason = "its two tracks ended beyond opposite ends of the levels"
        estimate = Estimate(
            value=value,
            low=low,
            high=high,
            share=share,
            censored=censored,
            hits=len(answers),
            step=step_at(self.levels, value) * self.steps[-1],
            distrust_reason=distrust_reason,
            ended_by_most=bool(short),
        )
        return mark_contradictions(estimate, verdicts_of(answers))
