"""What all search rules share: probes, answers, estimates, and the levels that they move on."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, Protocol

from rig.core.errors import ConfigError

Censored = Literal["", "above", "below"]


@dataclass(frozen=True, slots=True)
class Probe:
    """A wall to be judged: its stiffness, the track that asks, whether it is a catch trial that moves no track."""

    level: float
    track: int = 0
    catch: bool = False


@dataclass(frozen=True, slots=True)
class Answer:
    """A judged probe. `stable` is None where there is no verdict (unsure, invalid): the rule asks again."""

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
    """

    value: float
    low: float
    high: float
    share: float
    censored: Censored
    hits: int
    step: float = 0.0


class Rule(Protocol):
    """A way to find the limit; see the package."""

    def next(self, answers: Sequence[Answer]) -> Probe | None:
        """Return what to ask after these answers, or None when it is enough."""
        ...

    def estimate(self, answers: Sequence[Answer]) -> Estimate:
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
            f"{len(values)} levels of stiffness that do not rise from above zero",
            remedy="give two or more, each above the one before",
        )
    return values


def check_whole(name: str, value: int, least: int, most: int) -> None:
    """Raise `rig.core.errors.ConfigError` unless a setting is a whole number in its range."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ConfigError(
            f"{name} = {value!r} is not a whole number from {least} to {most}", remedy="choose another"
        )


def verdicts_of(answers: Sequence[Answer], track: int | None = None) -> list[tuple[float, bool]]:
    """Level and verdict of each answer that has one and is no catch trial; of one track, or of all."""
    return [
        (answer.probe.level, answer.stable)
        for answer in answers
        if answer.stable is not None and not answer.probe.catch and track in (None, answer.probe.track)
    ]
