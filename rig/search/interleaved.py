"""Two staircases that come from below and from above, in random turns, with catch trials among them.

Nobody can follow a track whose turn is drawn, so an answer says more of the wall and less of the last answer. A catch
trial shows the softest or the stiffest wall, whose verdict is known: how often it comes out otherwise is how often the
person slips.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rig.errors import ConfigError
from rig.search import psychometric
from rig.search.rule import Answer, Censored, Estimate, Probe, told
from rig.search.staircase import Staircase


@dataclass(frozen=True, slots=True, kw_only=True)
class CatchTrials:
    """What the catch trials showed: how many softest walls were not called stable, and stiffest ones that were."""

    soft: int
    soft_slips: int
    stiff: int
    stiff_slips: int


@dataclass(frozen=True, kw_only=True)
class Interleaved:
    """Tracks from the softest and the stiffest level; see `Staircase` for the settings that they share.

    Parameters
    ----------
    catch_share
        Share of trials that are catch trials (0 … 0.5).
    seed
        Of the turns and the catch trials.
    """

    levels: Sequence[float]
    stable_to_rise: int = 1
    steps: Sequence[int] = (4, 2, 1)
    turns: int = 6
    most: int = 40
    catch_share: float = 0.1
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", self._staircase.levels)
        if not 0.0 <= self.catch_share <= 0.5:
            raise ConfigError(
                f"catch_share = {self.catch_share:g} is outside 0 … 0.5", remedy="choose a smaller share"
            )

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

    def next(self, answers: Sequence[Answer]) -> Probe | None:
        """A draw among the tracks that go on, or a catch trial; an empty answer is asked again."""
        probes = [track.next(answers, number) for number, track in enumerate(self._tracks)]
        going = [probe for probe in probes if probe is not None]
        if not going:
            return None
        if answers and answers[-1].stable is None:
            return answers[-1].probe
        drawn = np.random.default_rng([self.seed, len(answers)])
        if drawn.random() < self.catch_share:
            return Probe(self.levels[0] if drawn.random() < 0.5 else self.levels[-1], track=-1, catch=True)
        return going[int(drawn.integers(len(going)))]

    def estimate(self, answers: Sequence[Answer]) -> Estimate:
        """Mean of both tracks, and the interval that all verdicts together give."""
        single = [
            track.estimate_of(track.walk(told(answers, number)), told(answers, number), len(answers))
            for number, track in enumerate(self._tracks)
        ]
        share = single[0].share
        low, high = psychometric.interval(tuple(self.levels), told(answers), share)
        values = [one.value for one in single if math.isfinite(one.value)]
        censored: Censored = next((one.censored for one in single if one.censored), "")
        return Estimate(
            value=sum(values) / len(values) if values else math.nan,
            low=low,
            high=high,
            share=share,
            censored=censored,
            hits=len(answers),
        )

    def catches(self, answers: Sequence[Answer]) -> CatchTrials:
        """What the catch trials among these answers showed."""
        caught = [answer for answer in answers if answer.probe.catch and answer.stable is not None]
        soft = [answer.stable for answer in caught if answer.probe.level == self.levels[0]]
        stiff = [answer.stable for answer in caught if answer.probe.level == self.levels[-1]]
        return CatchTrials(
            soft=len(soft), soft_slips=soft.count(False), stiff=len(stiff), stiff_slips=stiff.count(True)
        )
