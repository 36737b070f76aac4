"""How a claim is judged: numbers in, a ruling out.

A claim is tried in cases: rigs, hands, criteria, readings. It is reproduced when it holds in all of them. It is
reproduced only with a condition when it holds in every case under that condition; a condition is something that
a user can set (a cut-off, a word length, gains), and the rule names it, not the result. What holds in some other
cases, in some readings or on some random plants is not reproduced; how many they are stands beside it. What a search
found is known to a rung of it: rules that compare such numbers allow for that (`step`, the ratio of two rungs).

Three verdicts keep a claim from looking stronger than its evidence. It is reproduced *in part* where only its size or
only its direction is. It is *undecided* where it depends on a setting that the paper does not give. It *follows from
the method* where it could not have failed, as the same range with the same filter at the same rate.

Nothing here knows a rig or a result, so that a test can reach every verdict. A ruling has no words but the names of its
cases; the sentence beside it is made by the template of the paper's claims (`rig.extras.papers.claims`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, TypeVar

Words = TypeVar("Words", bound=tuple[str, ...])

MOST = 0.9  # of many plants or readings: so many have to agree


class ClaimStatus(StrEnum):
    """The verdict on a claim, without its condition."""

    REPRODUCED = "reproduced"
    ONLY_WITH = "reproduced only with"
    PARTLY = "reproduced in part:"
    FOLLOWS = "follows from the method"
    UNDECIDED = "undecided"
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
    conditions
        Settings that a user can choose, each with the cases under it.
    numbers
        What the sentence beside the verdict is made of; in a template ``ruling.name``.
    """

    status: ClaimStatus
    cases: Mapping[str, bool]
    numbers: Mapping[str, Any]
    conditions: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Any:
        return self.numbers[name]

    @property
    def held(self) -> list[str]:
        """Return cases in which the claim held."""
        return [name for name, holds in self.cases.items() if holds]

    @property
    def failed(self) -> list[str]:
        """Return cases in which the claim did not hold."""
        return [name for name, holds in self.cases.items() if not holds]

    @property
    def condition(self) -> str:
        """Return the conditions under which a claim held that did not hold in all cases."""
        return "; ".join(self.sufficient) if self.status is ClaimStatus.ONLY_WITH else ""

    @property
    def sufficient(self) -> list[str]:
        """Return conditions under which the claim held in every case."""
        return [name for name, cases in self.conditions.items() if all(self.cases[case] for case in cases)]

    @property
    def verdict(self) -> str:
        """Return the status of the ruling with its condition, in words."""
        return f"{self.status} {self.condition}".rstrip()

    def having(self, **numbers: Any) -> Ruling:
        """Return the same ruling with more numbers."""
        return replace(self, numbers={**self.numbers, **numbers})

    def partly(self) -> Ruling:
        """Return the same claim, reproduced in its size or its direction alone."""
        return replace(self, status=ClaimStatus.PARTLY)

    def undecided(self) -> Ruling:
        """Return the same claim, undecided if it held in some cases that the paper leaves open and not in others."""
        open_ = self.status is ClaimStatus.NOT and self.held and self.failed
        return replace(self, status=ClaimStatus.UNDECIDED) if open_ else self

    def following(self) -> Ruling:
        """Return the same claim, which could not have failed: where it held, that follows from the method."""
        return replace(self, status=ClaimStatus.FOLLOWS) if self.status is ClaimStatus.REPRODUCED else self

    def only(self, **numbers: Any) -> Ruling:
        """Return the same claim, reproduced only under a condition that is no case of its own."""
        return replace(self.having(**numbers), status=ClaimStatus.ONLY_WITH)


def judge(
    cases: Mapping[str, bool],
    *,
    conditions: Mapping[str, Sequence[str]] | None = None,
    **numbers: Any,
) -> Ruling:
    """Judge a claim that was tried in several cases, as the head of this file says.

    What was not tried is not reproduced.
    """
    found = Ruling(status=ClaimStatus.NOT, cases=cases, numbers=numbers, conditions=conditions or {})
    if cases and all(cases.values()):
        return replace(found, status=ClaimStatus.REPRODUCED)
    return replace(found, status=ClaimStatus.ONLY_WITH) if found.sufficient else found


def each(cases: Iterable[str]) -> dict[str, list[str]]:
    """Return the conditions of a claim in which every case is itself a setting that a user can choose."""
    return {case: [case] for case in cases}


def judge_settable(cases: Mapping[Words, bool], settable: Sequence[int], **numbers: Any) -> Ruling:
    """Judge cases named by several words, of which those at some places can be set: each such word is a condition."""
    conditions: dict[str, list[str]] = {}
    for place in settable:
        for case in cases:
            conditions.setdefault(case[place], []).append(", ".join(case))
    named = {", ".join(case): held for case, held in cases.items()}
    return judge(named, conditions=conditions, **numbers)


def judge_share(count: int, total: int, **numbers: Any) -> Ruling:
    """Judge a claim that holds in some of many readings or on some of many plants: reproduced in `MOST` of them."""
    share = count / total if total else 0.0
    return judge({"": total > 0 and share >= MOST}, count=count, total=total, share=share, **numbers)


def over(one: float, other: float) -> float:
    """Return a ratio that is defined: nothing over nothing is 1, something over nothing infinite."""
    return one / other if other > 0.0 else (math.inf if one > 0.0 else 1.0)


def within(value: float, target: float, factor: float) -> bool:
    """Return True if a value is within a factor of a target, both ways; nothing not above zero is."""
    return value > 0.0 and target / factor <= value <= target * factor
