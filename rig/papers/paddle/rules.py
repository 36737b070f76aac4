"""Rules for what the measured curves say. Words are in `claims.j2` beside this file.

They were committed before the first full run and not changed since, but not unseen: a coarse run of six rigs had been
looked at, and the range of damping was asked of a plausible rig only after it. The priors were narrowed after a full
run (see `rigs`).

Two limits of a simulated rig that differ by no more than a rung of its search are a tie, as two of one measured rung
are. A statement about the curves counts as reproduced when it holds on `MOST` of the plausible rigs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

from rig.papers.paddle import data
from rig.papers.rules import Ruling, judge, judge_share, over, within

# By which factors the difference's stiffest wall and its range of damping on a plausible rig may miss the measured.
PLAUSIBLE_PEAK, PLAUSIBLE_RANGE = 3.0, 1.5
OTHERS = tuple(name for name in data.ESTIMATORS if name != data.LEVANT)

Curve = Sequence[float]  # limits (N/m) over the dampings of a scale, from 0 on
Curves = Mapping[str, Curve]  # by estimator


def plausible(curves: Curves, dampings: Sequence[float]) -> bool:
    """Whether a rig is of the paddle's size: by the difference, the one estimator without settings of its own."""
    found = curves[data.DIFFERENCE]
    return within(max(found), data.peak(data.DIFFERENCE), PLAUSIBLE_PEAK) and within(
        reach(found, dampings), data.damping_range(data.DIFFERENCE), PLAUSIBLE_RANGE
    )


def apart(rigs: Sequence[Curves], step: float) -> Ruling:
    """Undamped walls differ by estimator."""
    ratios = [over(max(of), min(of)) for of in map(_undamped, rigs)]
    return judge_share(sum(ratio > step for ratio in ratios), len(rigs), largest=max(ratios, default=1.0))


def told_apart(told: Sequence[Sequence[float]], step: float) -> Ruling:
    """Undamped walls differ by estimator when the estimate itself is judged, as far as the measured ones do.

    `told` has the limits (N/m) of each rig. The measured ones differ by a factor 3: half of that is asked for.
    """
    measured = [curve[0] for curve in data.CURVES.values()]
    wanted = 0.5 * max(measured) / min(measured)
    ratios = [over(max(of), min(of)) for of in told]
    return judge_share(sum(ratio > max(wanted, step) for ratio in ratios), len(told), wanted=wanted)


def leads(rigs: Sequence[Curves], step: float) -> Ruling:
    """Levant's stiffest wall is the stiffest of all, or ties with it."""
    counts = count_leads(rigs, step)
    return judge_share(counts["ahead"] + counts["tie"], len(rigs), **counts)


def count_leads(rigs: Sequence[Curves], step: float) -> dict[str, int]:
    """On how many rigs Levant's stiffest wall is ahead of, ties with, or is behind the best of the others."""
    counts = {"ahead": 0, "tie": 0, "behind": 0}
    for ratio in map(lead, rigs):
        counts["ahead" if ratio > step else "behind" if ratio < 1.0 / step else "tie"] += 1
    return counts


def lead(curves: Curves) -> float:
    """Levant's stiffest wall over the stiffest of the others."""
    return over(max(curves[data.LEVANT]), max(max(curves[name]) for name in OTHERS))


def peak_order(rigs: Sequence[Curves], step: float) -> Ruling:
    """Levant, FOAW, Kalman, difference is the order of the stiffest walls, ties allowed."""
    order = (data.LEVANT, data.FOAW, data.KALMAN, data.DIFFERENCE)
    held = [_falls([max(c[name]) for name in order], step) for c in rigs]
    return judge_share(sum(held), len(rigs))


def widest(rigs: Sequence[Curves], dampings: Sequence[float]) -> Ruling:
    """Levant has the largest range of damping, a step of the dampings allowed."""
    ranges = [{name: reach(c[name], dampings) for name in data.ESTIMATORS} for c in rigs]
    step = dampings[1]
    held = [of[data.LEVANT] + step >= max(of.values()) for of in ranges]
    return judge_share(sum(held), len(rigs))


def range_order(rigs: Sequence[Curves], dampings: Sequence[float]) -> Ruling:
    """Levant, Kalman, FOAW, difference is the order of the ranges of damping, a step allowed."""
    order, step = (data.LEVANT, data.KALMAN, data.FOAW, data.DIFFERENCE), dampings[1]
    held = []
    for curves in rigs:
        ranges = [reach(curves[name], dampings) for name in order]
        held.append(all(one + step >= other for one, other in pairwise(ranges)))
    return judge_share(sum(held), len(rigs))


def above_difference(rigs: Sequence[Curves], step: float) -> Ruling:
    """At every damping Levant's wall is at least as stiff as the difference's."""
    held = [
        all(one * step >= other for one, other in zip(c[data.LEVANT], c[data.DIFFERENCE], strict=True))
        for c in rigs
    ]
    return judge_share(sum(held), len(rigs))


def first_rise(rigs: Sequence[Curves], step: float) -> Ruling:
    """Each curve first rises with damping."""
    held = [all(max(c[name]) > step * c[name][0] for name in data.ESTIMATORS) for c in rigs]
    return judge_share(sum(held), len(rigs))


def predicted(errors: Mapping[str, tuple[float, float]]) -> Ruling:
    """The rig that fits three curves best predicts the fourth better than the mean of the three does.

    `errors` (N/m rms) of the prediction and of that mean, by the estimator that was left out.
    """
    held = {name: rig < mean for name, (rig, mean) in errors.items()}
    return judge(held, errors=[(name, *of) for name, of in errors.items()])


def reach(curve: Curve, dampings: Sequence[float]) -> float:
    """Largest damping up to which every column holds some wall; less than 0 if none does."""
    held = -1.0
    for stiffness, damping in zip(curve, dampings, strict=True):
        if stiffness <= 0.0:
            break
        held = damping
    return held


def _undamped(curves: Curves) -> list[float]:
    return [curves[name][0] for name in data.ESTIMATORS]


def _falls(values: Sequence[float], step: float) -> bool:
    return all(one * step >= other for one, other in pairwise(values))
