"""Rules that judge the claims of Chawda et al.: each turns numbers into a ruling (verdict and its numbers).

A claim is tested in several *cases*, such as estimators. Gains and the band of an excitation can be chosen by a user,
so a claim may be reproduced "only with" them; the estimators and passivity tests cannot be such a condition.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from statistics import median

from rig.experiments.mapping.interface import FrequencyWidth
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
# N·s/m: filters act on the velocity only, so they differ only at walls with damping.
LEAST_DAMPING = 40.0
SAME_CONTROL = 0.03
WIDER = 1.2
BETTER_COMMON = 0.05  # share of the error
TRACED = 0.9  # of the columns
LOW_HZ, ATTENUATED = (
    10.0,
    0.8,
)  # lines up to here; least share of the ideal magnitude that is a slight attenuation


def is_in_order(widths: Sequence[float]) -> bool:
    """Return True if each K-width (stiffest passive wall, N/m) is larger than the next."""
    return all(first > second for first, second in pairwise(widths))


def stiffer(cases: Mapping[str, Sequence[float]], step: float = 1.0) -> Ruling:
    """Judge the claim that one stiffness limit is mostly larger than another.

    `cases` has, for each case, the ratios of the two limits at several dampings. `step` is the ratio of neighbouring
    stiffnesses of the search, below which a difference is not significant.
    """
    held = {name: mostly_stiffer(values, step) for name, values in cases.items()}
    return judge(held, conditions=each(held), ratios=list(cases.items()))


def mostly_stiffer(ratios: Sequence[float], step: float = 1.0) -> bool:
    """Return True if no ratio is clearly below 1, and the median ratio is above 1 by more than the search resolves.

    `step` is the ratio of neighbouring stiffnesses of the search.
    """
    return min(ratios) >= 1.0 / (STIFFER * step) and median(ratios) >= STIFFER * step**0.5


def mostly_larger(cases: Mapping[str, tuple[int, int]]) -> Ruling:
    """Judge the claim that the first of two K-widths (stiffest passive walls) is mostly the larger one.

    A value of `cases` is (number of results in which it is larger, number of results in which the two differ).
    """
    held = {name: above >= MOST * differ for name, (above, differ) in cases.items() if differ}
    above, differ = (sum(count[i] for count in cases.values()) for i in (0, 1))
    return judge(held, above=above, differ=differ)


def find_drop(dampings: Sequence[float], stiffnesses: Sequence[float]) -> float:
    """Return the damping (N·s/m) beyond which the stiffness limits stay below half of their peak; infinite if never."""
    peak = max(stiffnesses)
    found = math.inf
    for damping, stiffness in zip(reversed(dampings), reversed(stiffnesses), strict=True):
        if stiffness >= HALF * peak:
            break
        found = damping
    return found if peak > 0.0 else dampings[0]


def sharpness(stiffnesses: Sequence[float]) -> float:
    """Return how sharply stiffness limits drop: the largest ratio of a limit to the limit at the next damping."""
    return max((over(high, low) for high, low in pairwise(stiffnesses)), default=1.0)


def limited(ranges: Mapping[str, float], filtered: float, paper: float) -> Ruling:
    """Judge the claim that walls stay passive up to a smaller damping with Levant's than with the filtered difference.

    `ranges` has the largest damping (N·s/m) with Levant's differentiator by case, `filtered` that of the filtered
    difference. If their ratio is not near the paper's ratio `paper`, the claim is reproduced in part.
    """
    cases = {name: value <= LIMITED * filtered for name, value in ranges.items()}
    factors = [over(filtered, value) for value in ranges.values()]
    found = judge(cases, ranges=list(ranges.items()), filtered=filtered, factors=factors, paper=paper)
    near = all(within(factor, paper, NEAR_WIDTH) for factor in factors)
    return found if near or found.failed else found.partly()


def drops_at(drops: Mapping[str, tuple[float, float]], others: Sequence[float]) -> Ruling:
    """Judge the claim that the stiffness limits drop at the paper's dampings.

    A value of `drops` is (damping of the drop found here, damping in the paper); `others` are the drops with all gains
    that were tried, infinite for no drop (N·s/m).
    """
    finite = [value for value in others if math.isfinite(value)]
    return judge(
        {name: within(value, target, NEAR_DROP) for name, (value, target) in drops.items()},
        drops=[(name, value) for name, (value, _) in drops.items()],
        finite=finite,
        tried=len(others),
        beyond=len(others) - len(finite),
    )


def near_table(ours: Mapping[str, float], paper: Mapping[str, float], step: float = 1.0) -> bool:
    """Return True if every number of `ours` is within a factor of `NEAR_WIDTH` times `step` of the paper's number."""
    return all(within(ours[name], paper[name], NEAR_WIDTH * step) for name in paper)


def wider(ratios: Mapping[str, float], step: float = 1.0) -> Ruling:
    """Judge the claim that simulated K-widths (stiffest passive walls) exceed the paper's measured ones.

    `ratios` are simulated over measured, by estimator; `step` is the ratio of neighbouring stiffnesses of the grid.
    """
    return judge({name: r >= WIDER * step**0.5 for name, r in ratios.items()}, ratios=list(ratios.items()))


def unsurpassed(own: float, tried: Mapping[str, float], step: float = 1.0) -> Ruling:
    """Judge the claim that gains are the best: none of the `tried` K-widths exceeds their own by half a step or more.

    `step` is the ratio of neighbouring stiffnesses of the grid.
    """
    return judge({name: value < STIFFER * step**0.5 * own for name, value in tried.items()}, own=own)


def controlled(found: Mapping[str, float], theory: float) -> Ruling:
    """Judge whether all numbers of `found` agree within 3 % with `theory`, the value that theory predicts."""
    cases = {name: within(value, theory, 1.0 + SAME_CONTROL) for name, value in found.items()}
    return judge(cases, found=list(found.items()), theory=theory)


def lower(gains: Mapping[tuple[str, float], Sequence[float]]) -> Ruling:
    """Judge the claim that an estimator's error is lower than the errors of other estimators.

    A key of `gains` is (name of the other estimator, upper edge of the band in Hz); a value has, for each measurement,
    the share by which the error is lower.
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
    """Judge the paper's boundary search from the numbers of dampings at which its result is wrong.

    `above`: it ends on an island above the passive region; `below`: it ends inside of the region; `unseen`: it finds no
    wall. `columns` is the number of all dampings, `numbers` are for the sentence only.
    """
    wrong = above + below + unseen
    return judge(
        {"": wrong <= (1.0 - TRACED) * columns}, above=above, below=below, unseen=unseen, columns=columns
    ).having(**numbers)


def combined(foaw: FrequencyWidth, levant: FrequencyWidth, both: FrequencyWidth) -> Ruling:
    """Judge the claim that FOAW and Levant's differentiator together can be better than each: in K, in B and in error.

    No measure may be worse than that of either, and one must be better by 5 %. Undecided if some are worse: the paper
    neither defines the combination nor weighs the measures.
    """
    names = ("K-width", "B-width", "fidelity error")
    values = [(one.stiffness, one.damping, -one.worst_fidelity) for one in (foaw, levant, both)]
    best = [max(pair) for pair in zip(*values[:2], strict=True)]
    cases = {name: own >= other for name, own, other in zip(names, values[2], best, strict=True)}
    better = any(
        own - other > (STIFFER - 1.0) * abs(other) for own, other in zip(values[2], best, strict=True)
    )
    return judge(
        {**cases, "one measure better": better}, found=[(k, b, -error) for k, b, error in values]
    ).undecided()
