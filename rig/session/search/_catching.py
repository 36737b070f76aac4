"""Add catch trials to any search rule: occasional trials with the softest or stiffest wall, whose verdict is known.

If the limit lies between these two walls, the fraction of wrong verdicts is the lapse rate. The verdict of a catch
trial is not used for the limit and does not change the next wall of the rule.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from rig.core.errors import ConfigError
from rig.session.search._rule import Censored, Estimate, JudgedProbe, Probe, Rule, verdicts_of

MOST_SHARE = 0.5
# Number of the track in catch trials, which belong to no series or staircase.
TRACK = -1


@dataclass(frozen=True, slots=True, kw_only=True)
class CatchTrials:
    """Numbers of catch trials (walls whose verdict is known) and of wrong verdicts (lapses) on soft and stiff walls.

    A person who calls walls unstable too soon has lapses only on soft walls.

    Attributes
    ----------
    soft, false_unstable
        Number of verdicts on the softest wall, and number of these verdicts that were not "stable".
    stiff, false_stable
        Number of verdicts on the stiffest wall, and number of these verdicts that were "stable".
    """

    soft: int = 0
    false_unstable: int = 0
    stiff: int = 0
    false_stable: int = 0

    @property
    def count(self) -> int:
        """Number of catch trials (trials whose correct verdict is known) on the softest and on the stiffest wall."""
        return self.soft + self.stiff

    @property
    def lapses(self) -> int:
        """Number of wrong verdicts in catch trials, in which the correct verdict is known."""
        return self.false_unstable + self.false_stable

    @classmethod
    def of(
        cls, answers: Sequence[JudgedProbe], levels: Sequence[float], sides: Container[Censored]
    ) -> CatchTrials:
        """Count catch trials (trials whose correct verdict is known) and their wrong verdicts in a search's answers.

        `levels` are the stiffnesses of the search, ascending. `sides` ("above", "below") are those on which the
        stiffest stable wall lies beyond the levels: catch trials at that end are not counted, because the correct
        verdict is unknown.
        """
        caught = [(one.probe.level, one.stable) for one in answers if one.probe.catch]
        # A wall beyond the limit has no known verdict: then its catch trials measure no lapses.
        soft = [] if "below" in sides else [stable for level, stable in caught if level == levels[0]]
        stiff = [] if "above" in sides else [stable for level, stable in caught if level == levels[-1]]
        return cls(
            soft=len(soft) - soft.count(None),
            false_unstable=soft.count(False),
            stiff=len(stiff) - stiff.count(None),
            false_stable=stiff.count(True),
        )

    def __add__(self, other: CatchTrials) -> CatchTrials:
        return CatchTrials(
            soft=self.soft + other.soft,
            false_unstable=self.false_unstable + other.false_unstable,
            stiff=self.stiff + other.stiff,
            false_stable=self.false_stable + other.false_stable,
        )


@dataclass(frozen=True, kw_only=True)
class Catching:
    """Search rule that adds catch trials to another rule: walls whose verdict is known.

    Parameters
    ----------
    rule
        Search rule that chooses all other walls.
    levels
        Stiffnesses of the search, ascending.
    share
        Fraction of trials that are catch trials (0 … `MOST_SHARE`), on average half with the softest wall and half with
        the stiffest.
    seed
        Seed of the random positions of the catch trials.
    """

    rule: Rule
    levels: Sequence[float]
    share: float
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= MOST_SHARE:
            raise ConfigError(
                f"the share of catch trials among all trials is {self.share:g}; it must be from 0 to {MOST_SHARE:g}",
                remedy="choose a share within this range",
            )

    def next(self, answers: Sequence[JudgedProbe]) -> Probe | None:
        """Return a catch trial (a wall whose correct verdict is known), or the next wall of the other search rule.

        A catch trial without a verdict is repeated. Return None if the search is finished.
        """
        probe = self.rule.next(answers)
        if probe is None:
            return None
        since = takewhile(lambda one: one.probe.catch or one.stable is None, reversed(answers))
        # Number of catch trials since the latest verdict that belongs to the rule.
        caught = sum(one.stable is not None for one in since)
        return self._drawn(len(verdicts_of(answers)), caught) or probe

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return the estimate of the stiffest stable wall by the other search rule, without the catch trials."""
        return self.rule.estimate(answers)

    def _drawn(self, verdicts: int, caught: int) -> Probe | None:
        """Return a catch trial or None at random; the result is reproducible for equal arguments.

        `verdicts` is the number of verdicts of the rule so far, `caught` the number of catch trials since the latest
        verdict of the rule.
        """
        drawn = np.random.default_rng([self.seed, verdicts, caught])
        if drawn.random() >= self.share:
            return None
        return Probe(self.levels[0] if drawn.random() < 0.5 else self.levels[-1], track=TRACK, catch=True)
