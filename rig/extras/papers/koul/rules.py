"""Rules that judge the claims of Koul et al., with their thresholds: they convert plain numbers to rulings.

A claim is "reproduced" if it holds in all cases. A user can set cut-off and arithmetic of a wall, word length and hand,
so they can be conditions; rig and criterion cannot.
"""

from __future__ import annotations

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
LESS = 0.9  # of the undamped penetration
LIKE_NONE = 0.95
NOISIER = 3.0
NULL, SEEN = 0.2, 0.5  # of the true velocity


def rises(curves: Mapping[str, Sequence[float]], rates: Sequence[int], step: float = 1.0) -> Ruling:
    """Judge that K_max rises with the rate, from K_max at `rates` (Hz), by rig."""
    cases, ends = {}, []
    for name, stiffness in curves.items():
        by_rate = dict(zip(rates, stiffness, strict=True))
        slow, fast = by_rate[SLOW_HZ], by_rate[FAST_HZ]
        up = _rising([k for rate, k in by_rate.items() if rate <= FAST_HZ], step)
        cases[name] = up and over(fast, slow) >= RISE
        ends.append((name, slow, fast))
    return judge(cases, ends=ends)


def _rising(stiffnesses: Sequence[float], step: float) -> bool:
    """Return True if each stiffness is at least `DROP` times the one before."""
    return all(high >= DROP / step * low for low, high in pairwise(stiffnesses))


def levels_off(
    with_lag: Mapping[str, float | None], without_lag: Mapping[str, float | None], step: float = 1.0
) -> Ruling:
    """Judge that K levels off, from K at 50 kHz over K at 20 kHz, with and without lag; None: a search hit its cap."""
    found = judge(
        {name: r is not None and r <= LEVEL_OFF * step for name, r in with_lag.items()},
        ratios=[(name, ratio, without_lag[name]) for name, ratio in with_lag.items()],
        lag=False,  # whether it is what K levels off with
    )
    free = any(r is None or r >= STILL_RISING for r in without_lag.values())
    return found.only(lag=True) if found.status is ClaimStatus.REPRODUCED and free else found


def near(values: Mapping[str, float], target: float, factor: float) -> Ruling:
    """Judge that numbers are within a factor of the paper's `target`."""
    cases = {name: within(value, target, factor) for name, value in values.items()}
    return judge(cases, found=list(values.items()))


def level(values: Mapping[str, float], target: float, step: float = 1.0) -> Ruling:
    """Judge that stiffnesses are within `NUMBER` of the paper's on every rig; in part if within `LEVEL_FACTOR`."""
    close, far = near(values, target, NUMBER * step), near(values, target, LEVEL_FACTOR * step)
    if close.status is ClaimStatus.NOT and far.status is ClaimStatus.REPRODUCED:
        return close.partly()
    return close


def peaks(
    found: Mapping[tuple[str, str], Sequence[float]], wanted: Sequence[float], step: float = 1.0
) -> Ruling:
    """Judge that several stiffnesses have the paper's sizes and order, by rig and cut-off.

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
    """Judge that dual-rate and slow uniform walls have the same range of damping, from ratios simulated and linear."""
    cases = {name: within(ratio, 1.0, SAME_RANGE * step) for name, ratio in ratios.items()}
    cases |= {f"theory, {name}": within(ratio, 1.0, SAME_LINEAR) for name, ratio in linear.items()}
    return judge(cases, simulated=list(ratios.values()), linear=list(linear.values()))


def same_of_plants(ranges: Sequence[tuple[float, float]]) -> Ruling:
    """Judge that dual-rate and slow uniform walls have the same range of damping on most random plants."""
    return judge_share(
        sum(within(over(dual, slow), 1.0, SAME_LINEAR) for dual, slow in ranges), total=len(ranges)
    ).following()


def half(ratios: Mapping[tuple[str, str, str], float], step: float = 1.0) -> Ruling:
    """Judge that the fast uniform wall has half the range of dual-rate, from ratios by rig, cut-off and reading."""
    cases = {case: HALF_LOW / step <= ratio <= HALF_HIGH * step for case, ratio in ratios.items()}
    return judge_settable(cases, [1], ratios=list(ratios.values())).undecided()


def half_of_plants(ranges: Sequence[tuple[float, float]]) -> Ruling:
    """Judge that the fast uniform wall has at most about half the range of the dual-rate one on most random plants."""
    ratios = [over(fast, dual) for fast, dual in ranges]
    about = sum(HALF_LOW <= ratio <= HALF_HIGH for ratio in ratios) / len(ratios)
    return judge_share(sum(ratio <= HALF_HIGH for ratio in ratios), len(ratios), about=about)


def higher_peak(ratios: Mapping[tuple[str, str, str, str], float], step: float = 1.0) -> Ruling:
    """Judge that the dual-rate wall has the higher peak K, from ratios by rig, hand, cut-off and criterion."""
    cases = {case: ratio >= HIGHER * step**0.5 for case, ratio in ratios.items()}
    groups: dict[str, list[bool]] = {}
    for (rig, _, cutoff, _), held in cases.items():
        groups.setdefault(f"{rig}, {cutoff}", []).append(held)
    counts = [(name, sum(held), len(held)) for name, held in groups.items()]
    return judge_settable(cases, [1, 2], ratios=list(ratios.values()), groups=counts).undecided()


def loses(curves: Mapping[tuple[str, str, str], Curve], step: float = 1.0) -> Ruling:
    """Judge that K of the fast uniform wall falls as soon as damping is added, by rig, cut-off and reading."""
    cases: dict[tuple[str, str, str], bool] = {}
    most: dict[tuple[str, str, str], float] = {}
    for case, curve in curves.items():
        undamped, *damped = curve
        last = max((b for b, stiffness in curve if stiffness > 0.0), default=0.0)
        added = [over(stiffness, undamped[1]) for b, stiffness in damped if b >= ONCE_ADDED * last]
        most[case] = max(added, default=0.0)
        cases[case] = undamped[1] > 0.0 and bool(added) and most[case] <= DROP * step**0.5
    return judge_settable(cases, [1], most=[(", ".join(case), ratio) for case, ratio in most.items()])


def first_rises(curves: Mapping[tuple[str, str], Curve], step: float = 1.0) -> Ruling:
    """Judge that K of the slow uniform wall first rises with damping to a higher peak, by rig and reading."""
    cases, peaks = {}, []
    for case, curve in curves.items():
        stiffnesses = [stiffness for _, stiffness in curve]
        peak = stiffnesses.index(max(stiffnesses))
        higher = over(stiffnesses[peak], stiffnesses[0])
        cases[", ".join(case)] = higher >= HIGHER * step**0.5 and _rising(stiffnesses[: peak + 1], step)
        peaks.append((", ".join(case), higher, curve[peak][0]))
    return judge(cases, peaks=peaks)


def lower_penetration(peaks: Mapping[str, tuple[float, float, float]]) -> Ruling:
    """Judge that dual-rate has the lowest peak penetration, from peaks with no, uniform and dual-rate damping."""
    cases = {
        name: dual <= LESS * none and dual <= LESS * uniform for name, (none, uniform, dual) in peaks.items()
    }
    arithmetic: dict[str, list[str]] = {}
    for name in cases:
        arithmetic.setdefault(name.partition(", ")[2], []).append(name)
    return judge(cases, conditions=arithmetic, peaks=peaks)


def like_none(peaks: Mapping[str, tuple[float, float, float]]) -> Ruling:
    """Judge that the uniform wall is penetrated as deep as the undamped one, from peaks as in `lower_penetration`."""
    ratios = {name: over(uniform, none) for name, (none, uniform, _) in peaks.items()}
    cases = {name: ratio >= LIKE_NONE for name, ratio in ratios.items()}
    return judge(cases, conditions=each(cases), ratios=ratios)


def noisier(fast: Mapping[str, float], slow: float) -> Ruling:
    """Judge that the velocity at 20 kHz (by cut-off) is noisier than at 2 kHz, by the noise of a count (rad/s rms)."""
    ratios = {name: over(noise, slow) for name, noise in fast.items()}
    return judge(
        {name: ratio >= NOISIER for name, ratio in ratios.items()},
        conditions=each(ratios),
        slow=slow,
        fast=[(name, noise, ratios[name]) for name, noise in fast.items()],
    )


def null_late(readings: Mapping[str, tuple[float, float]]) -> Ruling:
    """Judge that no velocity is read late in the impact at 20 kHz, from the read shares at (20, 2) kHz, by case.

    The claim fails if no velocity is read at 2 kHz either, because this would show nothing about the rate.
    """
    cases = {name: fast <= NULL < slow for name, (fast, slow) in readings.items()}
    return judge(cases, conditions=each(cases), late=[fast for fast, _ in readings.values()])


def null_late_only(readings: Mapping[str, tuple[float, float]]) -> Ruling:
    """Judge that the velocity at 20 kHz is read early but not late in the impact, from the (early, late) shares."""
    cases = {name: late <= NULL and early >= SEEN for name, (early, late) in readings.items()}
    return judge(
        cases,
        conditions=each(cases),
        seen=max((early for early, late in readings.values() if late <= NULL), default=0.0),
    )
