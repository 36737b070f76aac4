"""Compare estimator–law pairs by the areas (K–B plane) of the walls that they render: which wins, and how stably.

The page of the ranking uses it. It must not run a hit: `measure` computes the areas that are compared here.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import stats
from rig.extras.papers.ranking import rule

RESULTS = Path(__file__).parent / "results.json"
Outcome = Literal["wins", "ties", "loses"]


@dataclass(frozen=True, slots=True)
class Ratio:
    """Area of one estimator–law pair divided by that of another: geometric mean over a rig's variations, with interval.

    The area is that of the rendered walls in the K–B plane, the interval a 95 % bootstrap interval.
    """

    mean: float
    low: float
    high: float

    @property
    def outcome(self) -> Outcome:
        """Result of the first of two estimator–law pairs against the second: "wins", "ties" or "loses"."""
        if self.mean > rule.WIN and self.low > 1.0:
            return "wins"
        return "loses" if self.mean < 1.0 / rule.WIN and self.high < 1.0 else "ties"


@cache  # a page compares most pairs several times
def compare_areas(first: tuple[float, ...], second: tuple[float, ...]) -> Ratio:
    """Return the ratio of two areas of rendered walls: its geometric mean and interval over the variations of a rig.

    Both have a value for each variation, in the same order.
    """
    log_ratios = np.log(first) - np.log(second)
    means = _resampling_weights(len(log_ratios)) @ log_ratios
    edge = 50.0 * (1.0 - rule.CONFIDENCE)
    low, high = np.percentile(means, [edge, 100.0 - edge])
    return Ratio(math.exp(log_ratios.mean()), math.exp(low), math.exp(high))


@cache
def _resampling_weights(variations: int) -> NDArray[np.float64]:
    drawn = np.random.default_rng(rule.SEED).integers(0, variations, (rule.RESAMPLED, variations))
    return np.stack([(drawn == number).mean(axis=1) for number in range(variations)], axis=1)


class Cell(NamedTuple):
    """Results of a pair (estimator, sampling, law) on a rig under one condition (grip of the hand and delay)."""

    areas: list[float]  # on the rig and its variations
    undamped: float  # N·m/rad or N/m
    error: float  # rad/s or m/s
    capped: int  # dampings at which even the highest stiffness counted


@dataclass(frozen=True, slots=True)
class RigResults:
    """Compact results of one rig in the ranking of estimator–law pairs.

    Attributes
    ----------
    rig
        Name of the rig.
    tuned
        Settings of each estimator.
    ends
        Estimators whose best value is at an end of its grid.
    noise
        Velocity of a toggling count at rest by estimator, rms (rad/s or m/s).
    conditions
        By pair and by condition (grip/delay): areas, undamped stiffness, velocity error, capped dampings (see `Cell`).
    """

    rig: str
    tuned: Mapping[str, Mapping[str, float | str]]
    ends: Sequence[str]
    noise: Mapping[str, float]
    conditions: Mapping[str, Mapping[str, Any]]

    @property
    def pairs(self) -> list[str]:
        """Names of the measured estimator–law pairs."""
        return list(self.conditions)

    @property
    def grips(self) -> list[str]:
        """Names of the measured grips of the hand; "none" is no hand."""
        return self._condition_parts(0)

    @property
    def delays(self) -> list[str]:
        """Measured delays (ticks), as text."""
        return self._condition_parts(1)

    def _condition_parts(self, place: int) -> list[str]:
        return list(dict.fromkeys(key.split("/")[place] for key in next(iter(self.conditions.values()))))

    def cell(self, pair: str, grip: str, delay: str) -> Cell:
        """Return the results of an estimator–law pair under a grip of the hand and a delay (ticks)."""
        return Cell(*self.conditions[pair][f"{grip}/{delay}"])

    def areas(self, pair: str, grip: str, delay: str) -> tuple[float, ...]:
        """Return the areas (K–B plane) of walls that an estimator–law pair renders, on the rig and its variations."""
        return tuple(self.cell(pair, grip, delay).areas)

    def best(self, grip: str, delay: str, among: Iterable[str] | None = None) -> str:
        """Return the estimator–law pair with the largest area of rendered walls, at a grip and a delay (ticks)."""
        return max(among or self.pairs, key=lambda pair: math.prod(self.areas(pair, grip, delay)))

    def ratio(self, pair: str, other: str, grip: str, delay: str) -> Ratio:
        """Return the area of walls that one estimator–law pair renders, divided by that of the pair `other`."""
        return compare_areas(self.areas(pair, grip, delay), self.areas(other, grip, delay))

    def never_lose(self, delay: str, *, own_laws: bool = True) -> list[str]:
        """Return the estimator–law pairs that win or tie against the best other pair at each grip, and without hand.

        Other pairs of the same estimator are rivals too, unless `own_laws` is False.
        """
        return [pair for pair in self.pairs if "loses" not in self._outcomes(pair, delay, own_laws=own_laws)]

    def recommended(self, delay: str, *, own_laws: bool = True) -> list[str]:
        """Return the estimator–law pairs that never lose and win at least once; empty if a grip was not measured."""
        if self.grips != list(rule.CONDITIONS):
            return []
        equal = self.never_lose(delay, own_laws=own_laws)
        return [pair for pair in equal if "wins" in self._outcomes(pair, delay, own_laws=own_laws)]

    def _outcomes(self, pair: str, delay: str, *, own_laws: bool) -> Iterator[Outcome]:
        """Yield the outcome at each grip; the caller stops at the first that decides, as each needs a bootstrap."""
        own = pair.partition(", ")[0]
        rivals = [
            rival for rival in self.pairs if rival != pair and (own_laws or rival.partition(", ")[0] != own)
        ]
        for grip in self.grips:
            yield self.ratio(pair, self.best(grip, delay, rivals), grip, delay).outcome


def scores(rigs: Sequence[RigResults], delay: str) -> dict[str, float]:
    """Return for each estimator–law pair ln(its area of rendered walls / the best pair's), mean over rigs and grips.

    Only pairs that every rig can run are ranked.
    """
    common = [pair for pair in rigs[0].pairs if all(pair in one.pairs for one in rigs)]
    totals = dict.fromkeys(common, 0.0)
    conditions = sum(len(one.grips) for one in rigs)
    for one in rigs:
        for grip in one.grips:
            log_areas = {pair: float(np.mean(np.log(one.areas(pair, grip, delay)))) for pair in common}
            largest = max(log_areas.values())
            for pair in common:
                totals[pair] += (log_areas[pair] - largest) / conditions
    return totals


def stability(rigs: Sequence[RigResults], delay: str) -> dict[str, float]:
    """Return, by rig, Kendall's τ between the ranking of estimator–law pairs on all rigs and that without this rig."""
    if len(rigs) < 2:
        return {}
    all_rigs = scores(rigs, delay)
    taus = {}
    for number, left_out in enumerate(rigs):
        other_rigs = scores([*rigs[:number], *rigs[number + 1 :]], delay)
        values = [[ranking[pair] for pair in all_rigs] for ranking in (all_rigs, other_rigs)]
        taus[left_out.rig] = float(stats.kendalltau(*values).statistic)
    return taus


def write_results(rigs: Sequence[Mapping[str, Any]], path: Path = RESULTS) -> None:
    """Write the ranking's results as JSON with one condition (grip, delay) on each line, so that diffs are short."""
    text = json.dumps(rigs, ensure_ascii=False, separators=(",", ":"))
    path.write_text(text.replace('],"', '],\n"') + "\n", encoding="utf-8")


def read_results(path: Path = RESULTS) -> list[RigResults]:
    """Return the ranking's results from a file; by default those in this package."""
    return [RigResults(**one) for one in json.loads(path.read_text(encoding="utf-8"))]
