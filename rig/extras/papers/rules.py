"""Judge the claims of papers: convert computed numbers to a ruling (verdict and the numbers behind it).

A claim is tested in *cases*: rigs, hands, criteria, ways to judge passivity. The claim is "reproduced" if it holds in
all cases, and "reproduced only with" a *condition* if it holds in every case under that condition. A condition is a
setting that a user can choose (a cut-off, a word length, gains), and the rule names it in advance. If a claim holds
only in some other cases or random plants, it is "not reproduced", and the number of these is reported. A limit that a
search found is known only to one of its steps: rules allow for that (`step`, the ratio of neighbouring stiffnesses).

Three more verdicts keep a claim from looking stronger than its evidence. A claim is reproduced *in part* if only its
size or only its direction is. It is *undecided* if it depends on a setting that the paper does not give. It *follows
from the method* if it could not have failed, such as the same range with the same filter at the same rate.

Rules use numbers only, no rig and no typed result, so that a test can produce every verdict. A ruling contains no text
but the names of its cases; the template of the paper's claims writes the sentence (`rig.extras.papers.claims`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, TypeVar

Words = TypeVar("Words", bound=tuple[str, ...])

MOST = 0.9  # share of random plants or passivity tests that must agree


class ClaimStatus(StrEnum):
    """Possible verdicts on a claim; "reproduced only with" is completed by a condition."""

    REPRODUCED = "reproduced"
    ONLY_WITH = "reproduced only with"
    PARTLY = "reproduced in part:"
    FOLLOWS = "follows from the method"
    UNDECIDED = "undecided"
    NOT = "not reproduced"


@dataclass(frozen=True, slots=True, kw_only=True)
class Ruling:
    """Result of a rule that judged a claim.

    Attributes
    ----------
    status
        Verdict without its condition.
    cases
        True if the claim held, by name of the case.
    conditions
        Settings that a user can choose, each with the names of its cases.
    numbers
        Values for the report's sentence, by name; ``ruling.name`` in a template.
    """

    status: ClaimStatus
    cases: Mapping[str, bool]
    numbers: Mapping[str, Any]
    conditions: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Any:
        return self.numbers[name]

    @property
    def held(self) -> list[str]:
        """Names of the cases in which the claim held."""
        return [name for name, holds in self.cases.items() if holds]

    @property
    def failed(self) -> list[str]:
        """Names of the cases in which the claim did not hold."""
        return [name for name, holds in self.cases.items() if not holds]

    @property
    def condition(self) -> str:
        """Conditions that suffice for the claim, as text; empty unless the status is "reproduced only with"."""
        return "; ".join(self.sufficient) if self.status is ClaimStatus.ONLY_WITH else ""

    @property
    def sufficient(self) -> list[str]:
        """Conditions under which the claim held in every case."""
        return [name for name, cases in self.conditions.items() if all(self.cases[case] for case in cases)]

    @property
    def verdict(self) -> str:
        """Status and condition of the claim, as text."""
        return f"{self.status} {self.condition}".rstrip()

    def having(self, **numbers: Any) -> Ruling:
        """Return this ruling (verdict and its numbers) with more numbers for the report's sentence."""
        return replace(self, numbers={**self.numbers, **numbers})

    def partly(self) -> Ruling:
        """Return this ruling with the status "reproduced in part": only the claim's size or only its direction is."""
        return replace(self, status=ClaimStatus.PARTLY)

    def undecided(self) -> Ruling:
        """Return this ruling as "undecided" if the claim is not reproduced, but held in some of its cases.

        Use this if the cases are settings that the paper does not give.
        """
        open_ = self.status is ClaimStatus.NOT and self.held and self.failed
        return replace(self, status=ClaimStatus.UNDECIDED) if open_ else self

    def following(self) -> Ruling:
        """Return this ruling as "follows from the method" if the claim was reproduced: it could not have failed."""
        return replace(self, status=ClaimStatus.FOLLOWS) if self.status is ClaimStatus.REPRODUCED else self

    def only(self, **numbers: Any) -> Ruling:
        """Return this ruling with the status "reproduced only with"; the template writes the condition."""
        return replace(self.having(**numbers), status=ClaimStatus.ONLY_WITH)


def judge(
    cases: Mapping[str, bool], *, conditions: Mapping[str, Sequence[str]] | None = None, **numbers: Any
) -> Ruling:
    """Judge a claim: "reproduced" if it holds in all `cases`.

    It is "reproduced only with" a condition if it holds in all cases of this condition. `numbers` are for the report's
    sentence only. A claim without cases is not reproduced.
    """
    found = Ruling(status=ClaimStatus.NOT, cases=cases, numbers=numbers, conditions=conditions or {})
    if cases and all(cases.values()):
        return replace(found, status=ClaimStatus.REPRODUCED)
    return replace(found, status=ClaimStatus.ONLY_WITH) if found.sufficient else found


def each(cases: Iterable[str]) -> dict[str, list[str]]:
    """Return {case: [case]}: the conditions of a claim whose cases are all settings that a user can choose."""
    return {case: [case] for case in cases}


def judge_settable(cases: Mapping[Words, bool], settable: Sequence[int], **numbers: Any) -> Ruling:
    """Judge a claim whose cases have names of several words, such as (rig, cut-off).

    The words at the indices `settable` are settings that a user can choose: the claim can be reproduced only with one
    of them. `numbers` are for the report's sentence only.
    """
    conditions: dict[str, list[str]] = {}
    for place in settable:
        for case in cases:
            conditions.setdefault(case[place], []).append(", ".join(case))
    named = {", ".join(case): held for case, held in cases.items()}
    return judge(named, conditions=conditions, **numbers)


def judge_share(count: int, total: int, **numbers: Any) -> Ruling:
    """Judge a claim that holds in `count` of `total` results: it is reproduced if it holds in at least 90 %."""
    share = count / total if total else 0.0
    return judge({"": total > 0 and share >= MOST}, count=count, total=total, share=share, **numbers)


def over(one: float, other: float) -> float:
    """Divide two numbers of at least zero; return 1 for 0/0, and infinity for another division by 0."""
    return one / other if other > 0.0 else (math.inf if one > 0.0 else 1.0)


def within(value: float, target: float, factor: float) -> bool:
    """Return True if a value above zero is between target / factor and target × factor."""
    return value > 0.0 and target / factor <= value <= target * factor
