"""Compare pairs (estimator, sampling, law) by their areas: who wins, which is best, and how stable the ranking is."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.core.deferred import stats
from rig.extras.papers.ranking import rule

RESULTS = Path(__file__).parent / "results.json"
Outcome = Literal["wins", "ties", "loses"]


@dataclass(frozen=True, slots=True)
class Ratio:
    """Geometric mean of the ratio of two pairs' areas over a rig's variations, with its bootstrap interval."""

    mean: float
    low: float
    high: float

    @property
    def outcome(self) -> Outcome:
        """Result of the first pair against the second: "wins", "ties" or "loses"."""
        if self.mean > rule.WIN and self.low > 1.0:
            return "wins"
        return "loses" if self.mean < 1.0 / rule.WIN and self.high < 1.0 else "ties"


def compare_areas(first: ArrayLike, second: ArrayLike) -> Ratio:
    """Return the ratio of two pairs' areas, which were measured on the same variations in the same order."""
    logs = np.log(first) - np.log(second)
    means = logs[_draws(len(logs))].mean(axis=1)
    edge = 50.0 * (1.0 - rule.CONFIDENCE)
    low, high = np.percentile(means, [edge, 100.0 - edge])
    return Ratio(math.exp(logs.mean()), math.exp(low), math.exp(high))


@cache
def _draws(rigs: int) -> NDArray[np.int64]:
    return np.random.default_rng(rule.SEED).integers(0, rigs, (rule.RESAMPLED, rigs))


class Cell(NamedTuple):
    """Results of a pair (estimator, sampling, law) on a rig under one condition (grip and delay)."""

    areas: list[float]  # on the rig and its variations
    undamped: float  # N·m/rad or N/m
    error: float  # rad/s or m/s
    capped: int  # dampings at which even the highest stiffness counted


@dataclass(frozen=True, slots=True)
class RigResults:
    """Compact results of one rig, as `rig.extras.papers.ranking.measure.measure_rig` returns them.

    Attributes
    ----------
    rig
        Name in `rule.RIGS`.
    tuned
        Settings of each estimator.
    ends
        Estimators whose best value is at an end of its grid.
    noise
        Velocity of a toggling count at rest by estimator, rms (rad/s or m/s).
    conditions
        Values of a `Cell` by pair and by condition (grip/delay).
    """

    rig: str
    tuned: Mapping[str, Mapping[str, float | str]]
    ends: Sequence[str]
    noise: Mapping[str, float]
    conditions: Mapping[str, Mapping[str, Any]]

    @property
    def pairs(self) -> list[str]:
        """Names of the measured pairs."""
        return list(self.conditions)

    def axis(self, place: int) -> list[str]:
        """Return the names of the measured grips (`place` 0) or delays (1)."""
        return list(dict.fromkeys(key.split("/")[place] for key in next(iter(self.conditions.values()))))

    def cell(self, pair: str, grip: str, delay: str) -> Cell:
        """Return the results of a pair under a condition."""
        return Cell(*self.conditions[pair][f"{grip}/{delay}"])

    def areas(self, pair: str, grip: str, delay: str) -> list[float]:
        """Return the areas of a pair on the rig and its variations."""
        return self.cell(pair, grip, delay).areas

    def best(self, grip: str, delay: str, among: Iterable[str] | None = None) -> str:
        """Return the pair with the largest geometric mean of its areas under a condition."""
        return max(
            among or self.pairs, key=lambda pair: float(np.mean(np.log(self.areas(pair, grip, delay))))
        )

    def ratio(self, pair: str, other: str, grip: str, delay: str) -> Ratio:
        """Return the ratio of a pair's areas to another's."""
        return compare_areas(self.areas(pair, grip, delay), self.areas(other, grip, delay))

    def never_lose(self, delay: str) -> list[str]:
        """Return the pairs that win or tie against the best other pair in each grip and without a hand."""
        return [pair for pair in self.pairs if "loses" not in self._outcomes(pair, delay)]

    def recommended(self, delay: str, *, own_laws: bool = True) -> list[str]:
        """Return the pairs that never lose and win at least once; none if a condition of the hand is not measured.

        Other pairs of the same estimator are rivals too, unless `own_laws` is False.
        """
        complete = self.axis(0) == list(rule.CONDITIONS)
        outcomes = {pair: self._outcomes(pair, delay, own_laws=own_laws) for pair in self.pairs if complete}
        return [pair for pair, found in outcomes.items() if "loses" not in found and "wins" in found]

    def _outcomes(self, pair: str, delay: str, *, own_laws: bool = True) -> list[Outcome]:
        own = pair.partition(", ")[0]
        others = [one for one in self.pairs if one != pair and (own_laws or one.partition(", ")[0] != own)]
        return [
            self.ratio(pair, self.best(grip, delay, others), grip, delay).outcome for grip in self.axis(0)
        ]


def scores(found: Sequence[RigResults], delay: str) -> dict[str, float]:
    """Return the mean logarithm of each pair's area over that of the best, over rigs and grips.

    Only pairs that every rig can run are ranked.
    """
    common = [pair for pair in found[0].pairs if all(pair in one.pairs for one in found)]
    totals = dict.fromkeys(common, 0.0)
    number = sum(len(one.axis(0)) for one in found)
    for one in found:
        for grip in one.axis(0):
            logs = {pair: float(np.mean(np.log(one.areas(pair, grip, delay)))) for pair in common}
            top = max(logs.values())
            for pair in common:
                totals[pair] += (logs[pair] - top) / number
    return totals


def stability(found: Sequence[RigResults], delay: str) -> dict[str, float]:
    """Return Kendall's τ between the ranking by all rigs and the one without a rig, by that rig's name."""
    if len(found) < 2:
        return {}
    whole = scores(found, delay)
    taus = {}
    for number, left_out in enumerate(found):
        part = scores([*found[:number], *found[number + 1 :]], delay)
        values = [[ranking[pair] for pair in whole] for ranking in (whole, part)]
        taus[left_out.rig] = float(stats.kendalltau(*values).statistic)
    return taus


def write_results(found: Sequence[Mapping[str, Any]], path: Path = RESULTS) -> None:
    """Write results as JSON with one condition on each line, so that the diff of a change is short."""
    text = json.dumps(found, ensure_ascii=False, separators=(",", ":"))
    path.write_text(text.replace('],"', '],\n"') + "\n", encoding="utf-8")


def read_results(path: Path = RESULTS) -> list[RigResults]:
    """Return the committed results, in the order of `rule.RIGS`."""
    return [RigResults(**one) for one in json.loads(path.read_text(encoding="utf-8"))]
