"""A simulated observer, and what each rule makes of it: bias, scatter, hits, and whether the intervals are honest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rig.search.psychometric import share_stable
from rig.search.rule import Answer, Estimate, Rule


@dataclass(frozen=True, slots=True, kw_only=True)
class Observer:
    """Somebody whose verdicts follow the psychometric function (`rig.search.psychometric`).

    `threshold` is K50, `spread` how gradually verdicts change, `slips` the share of verdicts that are turned round, as
    when a finger takes the wrong key.
    """

    threshold: float
    spread: float
    slips: float = 0.0

    def judge(self, stiffness: float, drawn: np.random.Generator) -> bool:
        """One verdict: stable or not."""
        return bool(drawn.random() < share_stable(stiffness, self.threshold, self.spread, self.slips))

    def level_of(self, share: float) -> float:
        """Stiffness with this share of stable verdicts, slips left aside."""
        return float(self.threshold + self.spread * np.log((1.0 - share) / share))


def run(rule: Rule, observer: Observer, seed: int, most: int = 100_000) -> list[Answer]:
    """Answers of an observer until the rule has enough, or `most` of them; the same seed gives the same."""
    drawn = np.random.default_rng(seed)
    answers: list[Answer] = []
    while len(answers) < most and (probe := rule.next(answers)) is not None:
        answers.append(Answer(probe, observer.judge(probe.level, drawn)))
    return answers


@dataclass(frozen=True, slots=True, kw_only=True)
class Performance:
    """What a rule made of an observer over many sessions; stiffnesses in the units of the levels.

    `bias` and `scatter` (standard deviation) are of the estimate against the stiffness that the rule aims at (K50 for
    the ascending rule, which aims at none); `covered` is the share of 95 % intervals that hold it.
    """

    rule: str
    observer: Observer
    bias: float
    scatter: float
    hits: float
    covered: float
    censored: float

    def as_mapping(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "observer": asdict(self.observer)}


def study(
    rules: Mapping[str, Rule], observers: Sequence[Observer], sessions: int, seed: int = 0
) -> list[Performance]:
    """Let every observer go through every rule so often."""
    return [
        _performance(name, rule, observer, sessions, seed)
        for observer in observers
        for name, rule in rules.items()
    ]


def _performance(name: str, rule: Rule, observer: Observer, sessions: int, seed: int) -> Performance:
    seeds = np.random.SeedSequence(seed).generate_state(sessions, np.uint64).tolist()
    found: list[Estimate] = [rule.estimate(run(rule, observer, one)) for one in seeds]
    truth = [observer.level_of(one.share if np.isfinite(one.share) else 0.5) for one in found]
    errors = np.array([one.value for one in found]) - truth
    inside = [one.low <= true <= one.high for one, true in zip(found, truth, strict=True)]
    return Performance(
        rule=name,
        observer=observer,
        bias=float(np.nanmean(errors)),
        scatter=float(np.nanstd(errors)),
        hits=float(np.mean([one.hits for one in found])),
        covered=float(np.mean(inside)),
        censored=float(np.mean([one.censored != "" for one in found])),
    )
