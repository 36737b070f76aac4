"""Staircase (up-down) search rule: stiffer after stable verdicts, softer after others; steps shrink at each reversal.

With `stable_to_rise` = 1 the rule converges to the stiffness at which half of the verdicts are stable. With n stable
verdicts to rise, the n-th power of the stable fraction is a half: 0.71 for n = 2, 0.79 for n = 3 (Levitt, Journal of
the Acoustical Society of America 49, 1971; "1-up-1-down", "1-up-2-down", "1-up-3-down", where up means softer). A
protocol selects it by ``search.rule = "staircase"``, which is the default.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rig.core.errors import ConfigError
from rig.session.search import _psychometric as psychometric
from rig.session.search._resolution import step_at
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

# After this number of verdicts in a row that would lead beyond an end of the levels, the limit lies beyond.
EDGE_VERDICTS = 3


@dataclass(slots=True)
class _Walk:
    """State of a staircase after some verdicts: current level, direction, and reversals so far."""

    place: int
    direction: int
    # Number of verdicts in a row that would have led beyond an end of the levels.
    pressed: int
    turns: Sequence[tuple[int, bool]]  # place, and whether the smallest step was active
    hits: int


@dataclass(frozen=True, kw_only=True)
class Staircase:
    """Search rule: an up-down staircase, which makes the wall stiffer after stable verdicts and softer after others.

    Parameters
    ----------
    levels
        Stiffnesses in ascending order.
    stable_to_rise
        Number of stable verdicts in a row before the wall gets stiffer.
    start
        First level; by default the middle one.
    steps
        Step sizes in numbers of levels. The next step size is used after each reversal, the last one for all that
        follow.
    turns
        Number of reversals at the smallest step after which the search ends.
    most
        Largest number of verdicts; a search that ends at this number sets `Estimate.distrust_reason`.
    seed
        Not used, because this rule is not random.
    """

    levels: Sequence[float]
    stable_to_rise: int = 1
    start: float | None = None
    steps: Sequence[int] = (4, 2, 1)
    turns: int = 8
    most: int = 60
    seed: int = 0

    def __post_init__(self) -> None:
        levels = checked_levels(self.levels)
        object.__setattr__(self, "levels", levels)
        object.__setattr__(self, "steps", tuple(self.steps))
        check_whole("stable_to_rise", self.stable_to_rise, 1, 10)
        check_whole("turns", self.turns, 2, 1000)
        check_whole("most", self.most, 1, 100_000)
        if not self.steps:
            raise ConfigError(
                "the staircase has no step sizes",
                remedy="give settings.steps in numbers of levels, like [4, 2, 1]",
            )
        for step in self.steps:
            check_whole("steps", step, 1, len(levels) - 1)
        if self.start is not None and self.start not in levels:
            raise ConfigError(
                f"start = {self.start:g} is not one of the levels of the staircase",
                remedy=f"choose one of {', '.join(f'{level:g}' for level in levels)}",
            )

    @property
    def share(self) -> float:
        """Fraction of stable verdicts (0 … 1) to which the staircase converges."""
        return float(0.5 ** (1.0 / self.stable_to_rise))

    def next(self, answers: Sequence[JudgedProbe], track: int = 0) -> Probe | None:
        """Return the staircase's current wall; None if the search is finished.

        Only answers with the number `track` are used, because several staircases may share one search.
        """
        walk = self.walk(verdicts_of(answers, track))
        return None if self.has_ended(walk) else Probe(self.levels[walk.place], track=track)

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return the mean stiffness of the reversals at the smallest step, with a 95 % interval from all verdicts."""
        verdicts = verdicts_of(answers, 0)
        return self.estimate_of(self.walk(verdicts), verdicts, len(answers))

    def walk(self, verdicts: Sequence[tuple[float, bool]]) -> _Walk:
        """Return the state of the staircase (current level, direction, reversals) after verdicts (level, stable)."""
        top, last = len(self.levels) - 1, len(self.steps) - 1
        place = len(self.levels) // 2 if self.start is None else list(self.levels).index(self.start)
        step = direction = run = pressed = 0
        turns = []
        for _, stable in verdicts:
            run = run + 1 if stable else 0
            if stable and run < self.stable_to_rise:
                continue
            before, direction, run = direction, 1 if stable else -1, 0
            if before == -direction:
                turns.append((place, step == last))
                step = min(step + 1, last)
            pressed = pressed + 1 if place == (top if stable else 0) else 0
            place = min(max(place + direction * self.steps[step], 0), top)
        return _Walk(place, direction, pressed, turns, len(verdicts))

    def has_ended(self, walk: _Walk) -> bool:
        """Return True if the search is finished.

        A search ends after `turns` reversals, after `most` verdicts, or after several verdicts that would move it
        beyond the lowest or highest level of stiffness.
        """
        fine = sum(1 for _, smallest in walk.turns if smallest)
        return fine >= self.turns or walk.hits >= self.most or walk.pressed >= EDGE_VERDICTS

    def estimate_of(self, walk: _Walk, verdicts: Sequence[tuple[float, bool]], hits: int) -> Estimate:
        """Return the estimate of the stiffest stable wall, from the staircase's state and verdicts."""
        fine = [self.levels[place] for place, smallest in walk.turns if smallest]
        # An even number of turns: upper and lower ones alternate, and an odd one would pull the mean to its side.
        places = fine[len(fine) % 2 :] or [self.levels[place] for place, _ in walk.turns]
        low, high = psychometric.interval(tuple(self.levels), verdicts, self.share)
        value = sum(places) / len(places) if places else math.nan
        censored: Censored = ""
        if walk.pressed >= EDGE_VERDICTS:
            censored = "above" if walk.direction > 0 else "below"
            value = self.levels[-1] if walk.direction > 0 else self.levels[0]
        low, high = psychometric.open_interval(censored, value, low, high)
        ended_by_most = not censored and len(fine) < self.turns and walk.hits >= self.most
        estimate = Estimate(
            value=value,
            low=low,
            high=high,
            share=self.share,
            censored=censored,
            hits=hits,
            step=step_at(self.levels, value) * self.steps[-1],
            distrust_reason=f"ended by most after {len(fine)} of {self.turns} turns" if ended_by_most else "",
            ended_by_most=ended_by_most,
        )
        return mark_contradictions(estimate, verdicts)
