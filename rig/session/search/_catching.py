"""Catch trials among the trials of any rule: now and then the softest or the stiffest wall, whose verdict is known.

It is known where the limit lies between them: the share that comes out otherwise is the lapse rate. A catch
trial counts for no limit and moves no track, so the rule that it stands among asks as if there were none.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from rig.core.errors import ConfigError
from rig.session.search._rule import Censored, Estimate, JudgedProbe, Probe, Rule, verdicts_of

MOST_SHARE = 0.5
TRACK = -1  # of a catch trial


@dataclass(frozen=True, slots=True, kw_only=True)
class CatchTrials:
    """Results of catch trials, by kind: a person who calls walls unstable too soon lapses on the soft ones alone.

    Attributes
    ----------
    soft, false_unstable
        Verdicts of the softest wall, and those among them that were not "stable".
    stiff, false_stable
        Verdicts of the stiffest wall, and those among them that were "stable".
    """

    soft: int = 0
    false_unstable: int = 0
    stiff: int = 0
    false_stable: int = 0

    @property
    def count(self) -> int:
        """Return the number of catch trials of both kinds."""
        return self.soft + self.stiff

    @property
    def lapses(self) -> int:
        """Return the number of lapses of both kinds."""
        return self.false_unstable + self.false_stable

    @classmethod
    def of(
        cls, answers: Sequence[JudgedProbe], levels: Sequence[float], sides: Container[Censored]
    ) -> CatchTrials:
        """Count the catch trials among answers.

        Parameters
        ----------
        levels
            Of the search.
        sides
            Where its limit lies beyond the levels: what the wall at that end is, is not known then.
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
    """A rule, with catch trials among its own.

    Parameters
    ----------
    rule
        That asks for all other walls.
    levels
        Of the search.
    share
        Of trials that are catch trials, half of them of either kind (0 … `MOST_SHARE`).
    seed
        Of their places.
    """

    rule: Rule
    levels: Sequence[float]
    share: float
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= MOST_SHARE:
            raise ConfigError(
                f"the share of catch trials, {self.share:g}, is outside 0 … {MOST_SHARE:g}",
                remedy="choose a share within this range",
            )

    def next(self, answers: Sequence[JudgedProbe]) -> Probe | None:
        """Return the rule's next probe, or a catch trial before it; an invalid catch trial is repeated."""
        probe = self.rule.next(answers)
        if probe is None:
            return None
        since = takewhile(lambda one: one.probe.catch or one.stable is None, reversed(answers))
        caught = sum(one.stable is not None for one in since)  # since the rule's own latest verdict
        return self._drawn(len(verdicts_of(answers)), caught) or probe

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return the rule's estimate, without the catch trials."""
        return self.rule.estimate(answers)

    def _drawn(self, verdicts: int, caught: int) -> Probe | None:
        """The catch trial after so many verdicts of the rule's own and so many catch trials since, if there is one."""
        drawn = np.random.default_rng([self.seed, verdicts, caught])
        if drawn.random() >= self.share:
            return None
        return Probe(self.levels[0] if drawn.random() < 0.5 else self.levels[-1], track=TRACK, catch=True)
