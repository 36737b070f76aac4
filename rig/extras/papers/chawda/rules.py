"""Rules that judge the claims of Chawda et al., with their thresholds: they convert plain numbers to rulings.

A user can set gains and the band of an excitation, so they are conditions; estimators and readings are cases.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from statistics import median

from rig.extras.papers.rules import MOST, Ruling, each, judge, judge_settable, over, within

# What the paper says.
DROP, DROP_ADJUSTED, FILTER_HOLDS, BETTER_UP_TO = 250.0, 300.0, 350.0, 150.0  # N·s/m, Fig. 3 and its text

# Thresholds of the rules.
STIFFER = 1.05  # or larger, of errors
LIMITED = 0.75  # of the range of damping of the filtered difference
HALF = 0.5  # of its own peak: where a Z-width has dropped
SHARP = 2.0  # from one damping to the next
NEAR_DROP = 1.25
NEAR_WIDTH = 1.5  # K-widths and fidelity against Table I
LEAST_DAMPING = 40.0  # N·s/m: what differs between filters is damping's work
SAME_CONTROL = 0.03
WIDER = 1.2
BETTER_COMMON = 0.05  # share of the error
TRACED = 0.9  # of the columns


def is_in_order(widths: Sequence[float]) -> bool:
    """Return True if each K-width is larger than the next; the caller sorts them in the paper's order."""
    return all(first > second for first, second in pairwise(widths))


def stiffer(cases: Mapping[str, Sequence[float]], step: float = 1.0) -> Ruling:
    """Judge that a limit is mostly larger than another, from their ratios at some dampings, by case.

    `step` is the ratio of two neighbouring stiffnesses of the search.
    """
    held = {name: mostly_stiffer(values, step) for name, values in cases.items()}
    return judge(held, conditions=each(held), ratios=list(cases.items()))


def mostly_stiffer(ratios: Sequence[float], step: float = 1.0) -> bool:
    """Return True if no ratio is clearly below 1, and their median is above 1 by more than the search's resolution."""
    return min(ratios) >= 1.0 / (STIFFER * step) and median(ratios) >= STIFFER * step**0.5


def mostly_larger(cases: Mapping[str, tuple[int, int]]) -> Ruling:
    """Judge that one K-width is mostly the larger of two, from (how often larger, how often different), by case."""
    held = {name: above >= MOST * differ for name, (above, differ) in cases.items() if differ}
    above, differ = (sum(count[i] for count in cases.values()) for i in (0, 1))
    return judge(held, above=above, differ=differ)


def find_drop(dampings: Sequence[float], stiffnesses: Sequence[float]) -> float:
    """Return the damping beyond the peak from which on the limits stay below half of the peak; infinite if never."""
    peak = max(stiffnesses)
    found = math.inf
    for damping, stiffness in zip(reversed(dampings), reversed(stiffnesses), strict=True):
        if stiffness >= HALF * peak:
            break
        found = damping
    return found if peak > 0.0 else dampings[0]


def sharpness(stiffnesses: Sequence[float]) -> float:
    """Return the largest ratio of the limits at two neighbouring dampings."""
    return max((over(high, low) for high, low in pairwise(stiffnesses)), default=1.0)


def limited(ranges: Mapping[str, float], filtered: float, paper: float) -> Ruling:
    """Judge that Levant's differentiator has a smaller range of damping (N·s/m) than the filtered difference.

    `paper` is the paper's ratio of both ranges; if ours are not near it, the claim is reproduced in part.
    """
    cases = {name: value <= LIMITED * filtered for name, value in ranges.items()}
    factors = [over(filtered, value) for value in ranges.values()]
    found = judge(cases, ranges=list(ranges.items()), filtered=filtered, factors=factors, paper=paper)
    near = all(within(factor, paper, NEAR_WIDTH) for factor in factors)
    return found if near or found.failed else found.partly()


def drops_at(drops: Mapping[str, tuple[float, float]], others: Sequence[float]) -> Ruling:
    """Judge that Z-widths drop at the paper's dampings (N·s/m); `others` are the drops of all gains that were tried."""
    finite = [value for value in others if math.isfinite(value)]
    return judge(
        {name: within(value, target, NEAR_DROP) for name, (value, target) in drops.items()},
        drops=[(name, value) for name, (value, _) in drops.items()],
        finite=finite,
        tried=len(others),
        beyond=len(others) - len(finite),
    )


def near_table(ours: Mapping[str, float], paper: Mapping[str, float], step: float = 1.0) -> bool:
    """Return True if every number is within `NEAR_WIDTH` times one step of the paper's."""
    return all(within(ours[name], paper[name], NEAR_WIDTH * step) for name in paper)


def wider(ratios: Mapping[str, float], step: float = 1.0) -> Ruling:
    """Judge that simulated K-widths are larger than the paper's measured ones, from their ratios by estimator."""
    return judge({name: r >= WIDER * step**0.5 for name, r in ratios.items()}, ratios=list(ratios.items()))


def controlled(found: Mapping[str, float], theory: float) -> Ruling:
    """Judge that numbers agree with the value that theory predicts."""
    cases = {name: within(value, theory, 1.0 + SAME_CONTROL) for name, value in found.items()}
    return judge(cases, found=list(found.items()), theory=theory)


def lower(gains: Mapping[tuple[str, float], Sequence[float]]) -> Ruling:
    """Judge that an estimator's error is below another's, from the shares by which it is lower at common walls.

    `gains` has the other's name and the upper edge of the band (Hz) as key, and a value for each measurement.
    """
    by_other: dict[str, list[float]] = {}
    for (other, _), values in gains.items():
        by_other.setdefault(other, []).extend(values)
    return judge_settable(
        {(other, f"a band up to {high:g} Hz"): min(v) >= BETTER_COMMON for (other, high), v in gains.items()},
        [1],
        gains=[(other, min(values), max(values)) for other, values in by_other.items()],
    )


def traced(above: int, below: int, unseen: int, columns: int, **numbers: float) -> Ruling:
    """Judge the boundary search from the numbers of dampings where it ends on an island, too low, or not at all."""
    wrong = above + below + unseen
    return judge(
        {"": wrong <= (1.0 - TRACED) * columns}, above=above, below=below, unseen=unseen, columns=columns
    ).having(**numbers)
