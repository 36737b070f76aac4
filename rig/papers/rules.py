"""How a claim is judged: numbers in, a ruling out.

Nothing here knows a rig or a result, so that a test can reach every verdict. A ruling has no words but the names of its
cases; the sentence beside it is made by the template of the paper's claims (`rig.papers.claims`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

MOST = 0.9  # of many plants or readings: so many have to agree


class Status(StrEnum):
    """The verdict on a claim, without its condition."""

    REPRODUCED = "reproduced"
    ONLY_WITH = "reproduced only with"
    NOT = "not reproduced"


@dataclass(frozen=True, slots=True, kw_only=True)
class Ruling:
    """What a rule decides.

    Attributes
    ----------
    status
        The verdict without its condition.
    cases
        In which cases the claim was tried, and whether it held.
    numbers
        What the sentence beside the verdict is made of; in a template ``ruling.name``.
    """

    status: Status
    cases: Mapping[str, bool]
    numbers: Mapping[str, Any]

    def __getitem__(self, name: str) -> Any:
        return self.numbers[name]

    @property
    def held(self) -> list[str]:
        """Cases in which the claim held."""
        return [name for name, holds in self.cases.items() if holds]

    @property
    def failed(self) -> list[str]:
        """Cases in which the claim did not hold."""
        return [name for name, holds in self.cases.items() if not holds]

    @property
    def condition(self) -> str:
        """The cases in which a claim held that did not hold in all of them."""
        return "; ".join(self.held) if self.status is Status.ONLY_WITH else ""

    @property
    def verdict(self) -> str:
        """The status with its condition."""
        return f"{self.status} {self.condition}".rstrip()

    def having(self, **numbers: Any) -> Ruling:
        """The same ruling with more numbers."""
        return replace(self, numbers={**self.numbers, **numbers})

    def only(self, **numbers: Any) -> Ruling:
        """The same claim, reproduced only under a condition."""
        return replace(self.having(**numbers), status=Status.ONLY_WITH)


def judge(cases: Mapping[str, bool], *, decisive: Sequence[str] = (), **numbers: Any) -> Ruling:
    """Judge a claim that was tried in several cases.

    Reproduced when it held in all of them (or in all of those named `decisive`, if any are named), not reproduced when
    in none, otherwise reproduced only with those in which it held.
    """
    needed = list(decisive) or list(cases)
    if cases and all(cases[name] for name in needed):
        status = Status.REPRODUCED
    else:
        status = Status.ONLY_WITH if any(cases.values()) else Status.NOT
    return Ruling(status=status, cases=cases, numbers=numbers)


def judge_share(count: int, total: int, **numbers: Any) -> Ruling:
    """Judge a claim that holds in some of many readings: reproduced in `MOST` of them, else only with some."""
    share = count / total if total else 0.0
    found = judge({"": total > 0 and share >= MOST}, count=count, total=total, share=share, **numbers)
    return found.only() if 0.0 < share < MOST else found


def over(one: float, other: float) -> float:
    """Return a ratio that is defined: nothing over nothing is 1, something over nothing infinite."""
    return one / other if other > 0.0 else (math.inf if one > 0.0 else 1.0)


def within(value: float, target: float, factor: float) -> bool:
    """Whether a value is within a factor of a target, both ways; nothing not above zero is."""
    return value > 0.0 and target / factor <= value <= target * factor
