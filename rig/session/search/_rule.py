"""Common parts of all search rules: probes (walls to judge), answers, estimates, and checks of levels and settings.

Every search rule imports this file; it must not import one of them.
"""

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
    """A wall to be judged: its stiffness (`level`), and True if its correct verdict is known (`catch`).

    `track` is the number of the ascending series or staircase that chose the wall, from 0.
    """

    level: float
    track: int = 0
    catch: bool = False


@dataclass(frozen=True, slots=True)
class JudgedProbe:
    """Answer to a presented wall: `stable` is True if the person judged the wall as stable, False if not.

    `stable` is None without a verdict (unsure), so that the rule presents the wall again.
    """

    probe: Probe
    stable: bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Estimated stiffness of the stiffest wall that a person judges as stable.

    Attributes
    ----------
    value
        Limit (unit of stiffness); NaN without any verdict.
    low, high
        Ends of the 95 % interval (unit of stiffness).
    share
        Fraction of stable verdicts at `value` to which the rule converges; NaN for the ascending rule, which has no
        target.
    censored
        "above" if the stiffest wall was still stable, "below" if the softest was not: the limit lies beyond the levels.
    hits
        Number of answers, with catch trials and answers without a verdict.
    step
        Distance between the two levels around `value`: the resolution of the estimate.
    distrust_reason
        Reason for which the value must not be used as a limit (`mark_contradictions`); empty if it may be used.
    ended_by_most
        True if the search reached its largest number of verdicts before its number of reversals (`Staircase.turns`);
        then `distrust_reason` is set.
    """

    value: float
    low: float
    high: float
    share: float
    censored: Censored
    hits: int
    step: float = 0.0
    distrust_reason: str = ""
    ended_by_most: bool = False


class Rule(Protocol):
    """Interface of a search rule, which chooses the walls to judge, and estimates the limit of stable walls."""

    def next(self, answers: Sequence[JudgedProbe]) -> Probe | None:
        """Return the next wall to judge, given all answers so far; None if the search is finished."""
        ...

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return the estimated stiffness of the stiffest stable wall from the answers to the walls so far."""
        ...


def checked_levels(levels: Iterable[float]) -> tuple[float, ...]:
    """Return stiffness levels as floats; raise `ConfigError` unless there are two or more, above 0, ascending."""
    values = tuple(float(level) for level in levels)
    rising = all(a < b for a, b in pairwise(values))
    if len(values) < 2 or not rising or not values[0] > 0.0 or not math.isfinite(values[-1]):
        raise ConfigError(
            f"the {len(values)} levels of stiffness {list(values[:5])}{' …' if len(values) > 5 else ''} are not valid",
            remedy="give two or more finite levels above 0, in ascending order",
        )
    return values


def check_whole(name: str, value: int, least: int, most: int) -> None:
    """Raise `rig.core.errors.ConfigError` unless the setting `name` is a whole number from `least` to `most`."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ConfigError(
            f"{name} = {value!r} is not a whole number from {least} to {most}",
            remedy=f"set {name} to a whole number in this range",
        )


def mark_contradictions(estimate: Estimate, verdicts: Sequence[tuple[float, bool]]) -> Estimate:
    """Return the estimate with a reason to distrust it, if the verdicts (level, stable) contradict its limit."""
    if estimate.distrust_reason or estimate.censored:
        return estimate
    reason = contradiction(estimate.value, estimate.low, estimate.high, verdicts)
    return replace(estimate, distrust_reason=reason)


def contradiction(value: float, low: float, high: float, verdicts: Sequence[tuple[float, bool]]) -> str:
    """Return why verdicts (stiffness, stable) contradict an estimated limit `value` and its interval, or "".

    A limit must lie in its own interval, and between a wall that was judged stable and a wall that was judged not
    stable.
    """
    if math.isnan(value):
        return ""
    # The mean of equal levels may differ from them by floating-point rounding.
    near = FLOATING * value
    if not low - near <= value <= high + near:
        return "the estimate lies outside its own interval"
    if not any(stable and level <= value + near for level, stable in verdicts):
        return "no wall up to the limit was judged stable"
    if all(stable or level < value - near for level, stable in verdicts):
        return "no wall from the limit upwards was judged not stable"
    return ""


def verdicts_of(answers: Sequence[JudgedProbe], track: int | None = None) -> list[tuple[float, bool]]:
    """Return stiffness and verdict (True: stable) of each judged wall, without catch trials and unsure verdicts.

    With `track`, only walls that this ascending series or staircase chose.
    """
    return [
        (answer.probe.level, answer.stable)
        for answer in answers
        if answer.stable is not None and not answer.probe.catch and track in (None, answer.probe.track)
    ]
