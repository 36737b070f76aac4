"""Rules that judge the claims of Chawda et al., with their thresholds: plain numbers in, a ruling out.

Gains and the band of an excitation can be set; estimators that a claim names, and readings, are cases of it.
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
    """Return True if each is larger than the next: K-widths in the order that the paper gives."""
    return all(first > second for first, second in pairwise(widths))


def stiffer(cases: Mapping[str, Sequence[float]], step: float = 1.0) -> Ruling:
    """Return ratios of two limits at several dampings, by case; `step` is the ratio of two rungs of the search."""
    held = {name: mostly_stiffer(values, step) for name, values in cases.items()}
    return judge(held, conditions=each(held), ratios=list(cases.items()))


def mostly_stiffer(ratios: Sequence[float], step: float = 1.0) -> bool:
    """Nowhere softer, and in the median stiffer by more than rounding and more than half a rung."""
    return min(ratios) >= 1.0 / (STIFFER * step) and median(ratios) >= STIFFER * step**0.5


def mostly_larger(cases: Mapping[str, tuple[int, int]]) -> Ruling:
    """Return how often one K-width is the larger of two, of how many readings that differ, by case."""
    held = {name: above >= MOST * differ for name, (above, differ) in cases.items() if differ}
    above, differ = (sum(count[i] for count in cases.values()) for i in (0, 1))
    return judge(held, above=above, differ=differ)


def find_drop(dampings: Sequence[float], stiffnesses: Sequence[float]) -> float:
    """Return damping beyond its peak from which on a Z-width stays below half of the peak; infinite if it does not."""
    peak = max(stiffnesses)
    found = math.inf
    for damping, stiffness in zip(reversed(dampings), reversed(stiffnesses), strict=True):
        if stiffness >= HALF * peak:
            break
        found = damping
    return found if peak > 0.0 else dampings[0]


def sharpness(stiffnesses: Sequence[float]) -> float:
    """Return the largest fall from one damping to the next, as a ratio."""
    return max((over(high, low) for high, low in pairwise(stiffnesses)), default=1.0)


def limited(ranges: Mapping[str, float], filtered: float, paper: float) -> Ruling:
    """Return the range of damping of Levant's differentiator, by case, against that of the filtered difference.

    Reproduced in its direction alone where the ratio of the two is not near that of the paper.
    """
    cases = {name: value <= LIMITED * filtered for name, value in ranges.items()}
    factors = [over(filtered, value) for value in ranges.values()]
    found = judge(cases, ranges=list(ranges.items()), filtered=filtered, factors=factors, paper=paper)
    near = all(within(factor, paper, NEAR_WIDTH) for factor in factors)
    return found if near or found.failed else found.partly()


def drops_at(drops: Mapping[str, tuple[float, float]], others: Sequence[float]) -> Ruling:
    """Return where Z-widths drop (ours, the paper's), and where they do over all gains that were tried."""
    finite = [value for value in others if math.isfinite(value)]
    return judge(
        {name: within(value, target, NEAR_DROP) for name, (value, target) in drops.items()},
        drops=[(name, value) for name, (value, _) in drops.items()],
        finite=finite,
        tried=len(others),
        beyond=len(others) - len(finite),
    )


def near_table(ours: Mapping[str, float], paper: Mapping[str, float], step: float = 1.0) -> bool:
    """Return True if every number is within `NEAR_WIDTH` of the paper's, a rung allowed."""
    return all(within(ours[name], paper[name], NEAR_WIDTH * step) for name in paper)


def wider(ratios: Mapping[str, float], step: float = 1.0) -> Ruling:
    """Return simulated widths over the paper's measured ones, by estimator."""
    return judge({name: r >= WIDER * step**0.5 for name, r in ratios.items()}, ratios=list(ratios.items()))


def controlled(found: Mapping[str, float], theory: float) -> Ruling:
    """Return numbers that theory fixes."""
    cases = {name: within(value, theory, 1.0 + SAME_CONTROL) for name, value in found.items()}
    return judge(cases, found=list(found.items()), theory=theory)


def lower(gains: Mapping[tuple[str, float], Sequence[float]]) -> Ruling:
    """Return by which share one estimator's error at common walls is lower than another's.

    By the other's name and upper edge of the band (Hz), measurement by measurement; below zero it is higher.
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
    """Return dampings at which the boundary search ends on an island, below the edge, or never comes to."""
    wrong = above + below + unseen
    return judge(
        {"": wrong <= (1.0 - TRACED) * columns}, above=above, below=below, unseen=unseen, columns=columns
    ).having(**numbers)
