"""What all search rules share: probes, answers, estimates, and the levels that they move on."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, Protocol

from rig.core.errors import ConfigError
from rig.session.search._resolution import FLOATING

Censored = Literal["", "above", "below"]


@dataclass(frozen=True, slots=True)
class Probe:
    """A wall to be judged: its stiffness, the track that asks, whether it is a catch trial that moves no track."""

    level: float
    track: int = 0
    catch: bool = False


@dataclass(frozen=True, slots=True)
class JudgedProbe:
    """A judged probe; `stable`: None without a verdict (unsure, invalid), so that the rule asks again."""

    probe: Probe
    stable: bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Where the limit lies.

    Attributes
    ----------
    value
        Stiffness; NaN without any verdict.
    low, high
        Interval of 95 %.
    share
        Share of stable verdicts at `value` that the rule aims at; the ascending rule aims at none (NaN).
    censored
        "above" when the stiffest wall was still held, "below" when the softest was not: the limit lies beyond.
    hits
        Verdicts that it cost, catch trials and invalid ones included.
    step
        Distance of the levels between which it lies, so how finely the value is known (`resolution`).
    mark
        Why the value is no limit that the verdicts show, see `mark_contradictions`; empty where it is one.
    ended_by_most
        True if the rule ended by its largest number of verdicts before it had its turns; then `mark` says so.
    """

    value: float
    low: float
    high: float
    share: float
    censored: Censored
    hits: int
    step: float = 0.0
    mark: str = ""
    ended_by_most: bool = False


class Rule(Protocol):
    """A way to find the limit; see the package."""

    def next(self, answers: Sequence[JudgedProbe]) -> Probe | None:
        """Return what to ask after these answers, or None when it is enough."""
        ...

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return the limit that these answers show, also when they are not yet enough."""
        ...


def checked_levels(levels: Iterable[float]) -> tuple[float, ...]:
    """Return the levels as a tuple of numbers.

    Raises `rig.core.errors.ConfigError` unless there are two or more, above zero and rising.
    """
    values = tuple(float(level) for level in levels)
    rising = all(a < b for a, b in pairwise(values))
    if len(values) < 2 or not rising or not values[0] > 0.0 or not math.isfinite(values[-1]):
        raise ConfigError(
            f"the {len(values)} levels of stiffness are not valid",
            remedy="give two or more levels above 0, in rising order",
        )
    return values


def check_whole(name: str, value: int, least: int, most: int) -> None:
    """Raise `rig.core.errors.ConfigError` unless a setting is a whole number in its range."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ConfigError(
            f"{name} = {value!r} is not a whole number from {least} to {most}",
            remedy="choose one in this range",
        )


def mark_contradictions(estimate: Estimate, verdicts: Sequence[tuple[float, bool]]) -> Estimate:
    """Return the estimate with the reason in `mark` if its own verdicts contradict it; see `contradiction`."""
    if estimate.mark or estimate.censored:
        return estimate
    return replace(estimate, mark=contradiction(estimate.value, estimate.low, estimate.high, verdicts))


def contradiction(value: float, low: float, high: float, verdicts: Sequence[tuple[float, bool]]) -> str:
    """Return why verdicts contradict a limit among the levels, or an empty text.

    A limit lies inside its own interval, and between a wall that was judged stable and one that was not.
    """
    if math.isnan(value):
        return ""
    near = FLOATING * value  # a mean of equal levels may differ from them by rounding
    if not low - near <= value <= high + near:
        return "the estimate lies outside its own interval"
    if not any(stable and level <= value + near for level, stable in verdicts):
        return "no wall up to the limit was judged stable"
    if all(stable or level < value - near for level, stable in verdicts):
        return "no wall from the limit upwards was judged not stable"
    return ""


def verdicts_of(answers: Sequence[JudgedProbe], track: int | None = None) -> list[tuple[float, bool]]:
    """Return the level and verdict of each answer that has one and is no catch trial; of one track, or of all."""
    return [
        (answer.probe.level, answer.stable)
        for answer in answers
        if answer.stable is not None and not answer.probe.catch and track in (None, answer.probe.track)
    ]
