"""Two staircases that come from below and from above, in random turns.

A person cannot follow a track whose turn is drawn at random, so an answer depends more on the wall and less on the
last answer.
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
    """Tracks from the softest and the stiffest level; see `Staircase` for the settings that they share.

    Parameters
    ----------
    seed
        Of the turns.
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
        """Return a draw among the tracks that have not ended; an answer without a verdict is asked again."""
        probes = [track.next(answers, number) for number, track in enumerate(self._tracks)]
        going = [probe for probe in probes if probe is not None]
        if not going:
            return None
        # A person cannot follow a track whose turn is random, so an answer depends more on the wall and less on the
        # last one.
        drawn = np.random.default_rng([self.seed, len(verdicts_of(answers))])
        return going[int(drawn.integers(len(going)))]

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return the mean of both tracks, and the interval that all verdicts together give."""
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
        short = [f"{one.mark}, track {number}" for number, one in enumerate(single, 1) if one.ended_by_most]
        mark = "; ".join(short)
        if {"above", "below"} <= {one.censored for one in single}:
            mark = "its two tracks ended beyond opposite ends of the levels"
        estimate = Estimate(
            value=value,
            low=low,
            high=high,
            share=share,
            censored=censored,
            hits=len(answers),
            step=step_at(self.levels, value) * self.steps[-1],
            mark=mark,
            ended_by_most=bool(short),
        )
        return mark_contradictions(estimate, verdicts_of(answers))
