"""Rules that judge the claims of Koul et al.: each turns numbers into a ruling (verdict and numbers).

A claim is "reproduced" if it holds in all cases. A user can set cut-off and arithmetic of a wall, word length and hand,
so these can be conditions of "reproduced only with"; rig and criterion cannot. `step` is everywhere the ratio of
neighbouring values of a search, below which a difference is not significant.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

from rig.extras.papers.rules import (
    MOST,
    ClaimStatus,
    Ruling,
    each,
    judge,
    judge_settable,
    judge_share,
    over,
    within,
)

Curve = Sequence[tuple[float, float]]  # dampings from zero up, and the largest stiffness at each

# What the paper says.
LEVEL, PEAK_DUAL, PEAK_SLOW = 560.0, 780.0, 350.0  # N·m/rad
DUAL_AT_RANGE = 280.0  # N·m/rad: remaining stiffness of the dual-rate wall at the end of its range
DAMPING_RANGE, DAMPING_RANGE_FAST = 3.3, 1.7  # N·m·s/rad
HALF = DAMPING_RANGE_FAST / DAMPING_RANGE
FAST_HZ, SLOW_HZ = 20_000, 2000
LOWER_HZ = (
    30.0,
    50.0,
    70.0,
    100.0,
    140.0,
)  # cut-offs below the 200 Hz of the dual-rate wall; 30 Hz is its example
FILTER_DELAYS_S = {200.0: 1e-3, 30.0: 1e-2}  # at 2 kHz, by cut-off (Hz)

# Thresholds of the rules.
MOST_PLANTS = MOST
DROP = 0.95  # K may fall by so much from one rate or damping to the next and still count as rising
RISE = 2.0  # K at 20 kHz over that at 2 kHz
LEVEL_OFF = 1.25  # K at 50 kHz over that at 20 kHz: at most
STILL_RISING = 1.6  # the same without what levels it off: at least
LEVEL_FACTOR = 1.65  # of the paper's number, both ways: its size and no more
SAME_RANGE = 1.1  # in simulation
SAME_LINEAR = 1.05  # in linear theory
NUMBER = 1.15  # of the paper's number for a range of damping
HALF_LOW, HALF_HIGH = 0.35, 0.65
HIGHER = 1.05
ONCE_ADDED = 0.1  # of the range of damping: from here on damping counts as added
LESS = 0.9  # of the value compared with, at most: clearly less
LIKE_NONE = 0.95
SLIGHTLY = 0.8  # of the undamped penetration, at least: only slightly less
NOISIER = 3.0
BETTER = 0.95  # of the other rms error, at most
SLOW_RATE_HZ, FAST_RATE_HZ = 5000, 10_000  # below and above which one estimator should be the better one
NULL, SEEN = 0.2, 0.5  # of the true velocity


def rises(curves: Mapping[str, Sequence[float]], rates: Sequence[int], step: float = 1.0) -> Ruling:
    """Judge the claim that the largest stable stiffness rises with the sampling rate.

    `curves` has this stiffness at each of `rates` (Hz), by rig.
    """
    cases, ends = {}, []
    for name, stiffness in curves.items():
        by_rate = dict(zip(rates, stiffness, strict=True))
        slow, fast = by_rate[SLOW_HZ], by_rate[FAST_HZ]
        up = _rising([k for rate, k in by_rate.items() if rate <= FAST_HZ], step)
        cases[name] = up and over(fast, slow) >= RISE
        ends.append((name, slow, fast))
    return judge(cases, ends=ends)


def _rising(stiffnesses: Sequence[float], step: float) -> bool:
    return all(high >= DROP / step * low for low, high in pairwise(stiffnesses))


def levels_off(
    with_lag: Mapping[str, float | None], without_lag: Mapping[str, float | None], step: float = 1.0
) -> Ruling:
    """Judge the claim that the largest stable stiffness K no longer rises above 20 kHz, with the amplifier's lag.

    A value is K at 50 kHz divided by K at 20 kHz, by rig; None: a search reached its highest stiffness. If K still
    rises without lag, the claim is reproduced only with lag.
    """
    found = judge(
        {name: ratio is not None and ratio <= LEVEL_OFF * step for name, ratio in with_lag.items()},
        ratios=[(name, ratio, without_lag[name]) for name, ratio in with_lag.items()],
        lag=False,  # True if K levels off only with the lag
    )
    free = any(ratio is None or ratio >= STILL_RISING for ratio in without_lag.values())
    return found.only(lag=True) if found.status is ClaimStatus.REPRODUCED and free else found


def near(values: Mapping[str, float], target: float, factor: float) -> Ruling:
    """Judge the claim that all values agree with the paper's `target`: within `factor`, smaller or larger."""
    cases = {name: within(value, target, factor) for name, value in values.items()}
    return judge(cases, found=list(values.items()))


def level(values: Mapping[str, float], target: float, step: float = 1.0) -> Ruling:
    """Judge the claim that stiffnesses are within a factor of 1.15 of `target` on every rig; in part if within 1.65."""
    close, far = near(values, target, NUMBER * step), near(values, target, LEVEL_FACTOR * step)
    if close.status is ClaimStatus.NOT and far.status is ClaimStatus.REPRODUCED:
        return close.partly()
    return close


def peaks(
    found: Mapping[tuple[str, str], Sequence[float]], wanted: Sequence[float], step: float = 1.0
) -> Ruling:
    """Judge the claim that several peak stiffnesses have the paper's sizes `wanted` and its order, by rig and cut-off.

    If only the sizes agree, the claim is reproduced in part.
    """
    near_all = {
        case: all(within(k, k0, LEVEL_FACTOR * step) for k, k0 in zip(stiffnesses, wanted, strict=True))
        for case, stiffnesses in found.items()
    }
    ordered = {
        case: all(high > low for high, low in pairwise(stiffnesses)) for case, stiffnesses in found.items()
    }
    numbers = [(", ".join(case), *stiffnesses) for case, stiffnesses in found.items()]
    both = judge_settable({case: near_all[case] and ordered[case] for case in found}, [1], found=numbers)
    sizes = judge_settable(near_all, [1])
    if both.status is ClaimStatus.NOT and sizes.status is not ClaimStatus.NOT:
        return both.partly()
    return both


def same(ratios: Mapping[str, float], linear: Mapping[str, float], step: float = 1.0) -> Ruling:
    """Judge the claim that walls have the same range of damping with dual-rate and with slow uniform sampling.

    `ratios` are dual-rate over slow uniform ranges, simulated by case; `linear` are those of linear theory by case.
    """
    cases = {name: within(ratio, 1.0, SAME_RANGE * step) for name, ratio in ratios.items()}
    cases |= {f"theory, {name}": within(ratio, 1.0, SAME_LINEAR) for name, ratio in linear.items()}
    return judge(cases, simulated=list(ratios.values()), linear=list(linear.values()))


def same_of_plants(ranges: Sequence[tuple[float, float]]) -> Ruling:
    """Judge on random plants the claim that dual-rate and slow uniform sampling allow the same range of damping.

    `ranges` are the largest dampings (dual-rate, slow uniform) of each plant (N·m·s/rad).
    """
    return judge_share(
        sum(within(over(dual, slow), 1.0, SAME_LINEAR) for dual, slow in ranges), total=len(ranges)
    ).following()


def half(ratios: Mapping[tuple[str, str, str], float], step: float = 1.0) -> Ruling:
    """Judge the claim that fast uniform sampling allows half the range of damping of dual-rate sampling.

    `ratios` are fast over dual-rate, by (rig, cut-off, criterion or theory).
    """
    cases = {case: HALF_LOW / step <= ratio <= HALF_HIGH * step for case, ratio in ratios.items()}
    return judge_settable(cases, [1], ratios=list(ratios.values())).undecided()


def half_of_plants(ranges: Sequence[tuple[float, float]]) -> Ruling:
    """Judge on random plants the claim that fast uniform sampling allows at most half the damping of dual-rate.

    `ranges` are the largest dampings (fast uniform, dual-rate) of each plant (N·m·s/rad).
    """
    ratios = [over(fast, dual) for fast, dual in ranges]
    about = sum(HALF_LOW <= ratio <= HALF_HIGH for ratio in ratios) / len(ratios)
    return judge_share(sum(ratio <= HALF_HIGH for ratio in ratios), len(ratios), about=about)


def higher_peak(ratios: Mapping[tuple[str, str, str, str], float], step: float = 1.0) -> Ruling:
    """Judge the claim that dual-rate sampling allows a higher peak stiffness than fast uniform sampling.

    A value of `ratios` is the peak with dual-rate sampling over that with fast uniform sampling; the key is (rig, hand,
    cut-off, stability criterion).
    """
    cases = {case: ratio >= HIGHER * step**0.5 for case, ratio in ratios.items()}
    groups: dict[str, list[bool]] = {}
    for (rig, _, cutoff, _), held in cases.items():
        groups.setdefault(f"{rig}, {cutoff}", []).append(held)
    counts = [(name, sum(held), len(held)) for name, held in groups.items()]
    return judge_settable(cases, [1, 2], ratios=list(ratios.values()), groups=counts).undecided()


def loses(curves: Mapping[tuple[str, str, str], Curve], step: float = 1.0) -> Ruling:
    """Judge the claim that the stiffness limit with fast uniform sampling falls as soon as damping is added.

    The keys of `curves` are (rig, cut-off, stability criterion or theory).
    """
    cases: dict[tuple[str, str, str], bool] = {}
    most: dict[tuple[str, str, str], float] = {}
    for case, curve in curves.items():
        (_, undamped), *damped = curve
        last = max((damping for damping, stiffness in curve if stiffness > 0.0), default=0.0)
        added = [over(stiffness, undamped) for damping, stiffness in damped if damping >= ONCE_ADDED * last]
        most[case] = max(added, default=0.0)
        cases[case] = undamped > 0.0 and bool(added) and most[case] <= DROP * step**0.5
    return judge_settable(cases, [1], most=[(", ".join(case), ratio) for case, ratio in most.items()])


def first_rises(curves: Mapping[tuple[str, str], Curve], step: float = 1.0) -> Ruling:
    """Judge the claim that the stiffness limit with slow uniform sampling first rises with damping to a peak.

    The keys of `curves` are (rig, stability criterion or theory).
    """
    cases, peaks = {}, []
    for case, curve in curves.items():
        stiffnesses = [stiffness for _, stiffness in curve]
        peak = stiffnesses.index(max(stiffnesses))
        higher = over(stiffnesses[peak], stiffnesses[0])
        cases[", ".join(case)] = higher >= HIGHER * step**0.5 and _rising(stiffnesses[: peak + 1], step)
        peaks.append((", ".join(case), higher, curve[peak][0]))
    return judge(cases, peaks=peaks)


def lower_penetration(peaks: Mapping[str, tuple[float, float, float]]) -> Ruling:
    """Judge the claim that dual-rate damping gives the lowest peak penetration, or the lowest decay.

    A value of `peaks` has the penetrations (counts), or decays, with no, uniform and dual-rate damping.
    """
    cases = {
        name: dual < uniform and dual <= LESS * none and dual <= LESS * uniform
        for name, (none, uniform, dual) in peaks.items()
    }
    arithmetic: dict[str, list[str]] = {}
    for name in cases:
        arithmetic.setdefault(name.partition(", ")[2], []).append(name)
    return judge(cases, conditions=arithmetic, peaks=peaks)


def between(peaks: Mapping[str, tuple[float, float, float]]) -> Ruling:
    """Judge the claim that uniform damping is slightly better than none, and dual-rate damping clearly better than it.

    A value of `peaks` has the penetrations (counts) with no, uniform and dual-rate damping; the last word of its key is
    the arithmetic, which can be set.
    """
    cases = {
        name: dual <= LESS * uniform and SLIGHTLY * none <= uniform < LIKE_NONE * none
        for name, (none, uniform, dual) in peaks.items()
    }
    return judge(cases, conditions={name.partition(", ")[2]: [name] for name in cases}, peaks=peaks)


def like_none(peaks: Mapping[str, tuple[float, float, float]]) -> Ruling:
    """Judge the claim that a damped wall with uniform sampling is penetrated as deep as the undamped wall.

    A value of `peaks` has the penetrations (counts) with no, uniform and dual-rate damping.
    """
    ratios = {name: over(uniform, none) for name, (none, uniform, _) in peaks.items()}
    cases = {name: ratio >= LIKE_NONE for name, ratio in ratios.items()}
    return judge(cases, conditions=each(cases), ratios=ratios)


def filter_delay(paper: Mapping[float, float]) -> Ruling:
    """Judge the claim that the velocity filter at 2 kHz has the paper's delay (s) for each cut-off (Hz).

    The delay is that of a digital second-order Butterworth filter at low frequency, without the half period of the
    difference quotient. In part if the delay agrees at some of the cut-offs.
    """
    period_s, cases, found = 1.0 / SLOW_HZ, {}, []
    for cutoff_hz, delay_s in paper.items():
        own_s = math.sqrt(2.0) * period_s / (2.0 * math.tan(math.pi * cutoff_hz * period_s))
        cases[f"{cutoff_hz:g} Hz"] = within(own_s, delay_s, NUMBER)
        found.append((cutoff_hz, delay_s, own_s, own_s + 0.5 * period_s))
    ruling = judge(cases, found=found)
    return ruling.partly() if ruling.held and ruling.failed else ruling


def sometimes_better(errors: Mapping[str, Sequence[float | None]]) -> Ruling:
    """Judge the claim that a cut-off below 200 Hz may sometimes estimate better: by more than 10 % on some rig.

    A value of `errors` has the rms errors (rad/s) at 200 Hz and at lower cut-offs, None if the wall is not stable; the
    key is rig and push. Where the wall is not stable at 200 Hz, nothing is compared.
    """
    lower = {name: [one for one in of[1:] if one is not None] for name, of in errors.items()}
    ratios = {
        name: min(lower[name]) / of[0] for name, of in errors.items() if of[0] is not None and lower[name]
    }
    return judge({"": any(ratio <= LESS for ratio in ratios.values())}, ratios=list(ratios.items()))


def best_below(errors: Mapping[tuple[str, int], tuple[float, float]]) -> Ruling:
    """Judge the claim that the filtered difference is best below 5 kHz, and Levant's differentiator above 10 kHz.

    A value of `errors` has the rms errors (m/s) of both, each tuned; the key is (resolution, rate in Hz). In part if
    the first half alone holds with every resolution; undecided if it depends on the resolution.
    """
    slow = {key: of[0] <= BETTER * of[1] for key, of in errors.items() if key[1] < SLOW_RATE_HZ}
    fast = {key: of[1] <= BETTER * of[0] for key, of in errors.items() if key[1] > FAST_RATE_HZ}
    cases = {f"{name}, {rate / 1e3:g} kHz": held for (name, rate), held in (slow | fast).items()}
    found = judge(cases, found=[(name, rate / 1e3, *of) for (name, rate), of in errors.items()])
    return found.partly() if all(slow.values()) and found.failed else found.undecided()


def noisier(fast: Mapping[str, float], slow: float) -> Ruling:
    """Judge the claim that velocity noise at 20 kHz (`fast`, by cut-off) exceeds the noise at 2 kHz (rad/s rms)."""
    ratios = {name: over(noise, slow) for name, noise in fast.items()}
    return judge(
        {name: ratio >= NOISIER for name, ratio in ratios.items()},
        conditions=each(ratios),
        slow=slow,
        fast=[(name, noise, ratios[name]) for name, noise in fast.items()],
    )


def null_late(readings: Mapping[str, tuple[float, float]]) -> Ruling:
    """Judge the claim that the velocity estimated at 20 kHz is null late in the impact.

    A value of `readings` is the estimated divided by the true velocity at (20, 2) kHz. The claim fails if the estimate
    at 2 kHz is null, too, because this would show nothing about the rate.
    """
    cases = {name: fast <= NULL < slow for name, (fast, slow) in readings.items()}
    return judge(cases, conditions=each(cases), late=[fast for fast, _ in readings.values()])


def null_late_only(readings: Mapping[str, tuple[float, float]]) -> Ruling:
    """Judge the claim that the velocity estimated at 20 kHz is null late in the impact, but not early.

    A value of `readings` is the estimated divided by the true velocity, (early, late).
    """
    cases = {name: late <= NULL and early >= SEEN for name, (early, late) in readings.items()}
    return judge(
        cases,
        conditions=each(cases),
        seen=max((early for early, late in readings.values() if late <= NULL), default=0.0),
    )
