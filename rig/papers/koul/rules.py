"""Rules that judge the claims of Koul et al.: plain numbers in, verdict out, each with its thresholds.

Nothing here knows a rig or a result, so that a test can reach every verdict. "Reproduced" wants what the paper wants:
all cases, or all that are not fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

from rig.papers.frame import Finding, Status, over, shown, times, verdict_over, within

# What the paper says.
LEVEL, PEAK_DUAL, PEAK_SLOW = 560.0, 780.0, 350.0  # N·m/rad
DUAL_AT_RANGE = 280.0  # N·m/rad: what is left of the dual-rate wall at the end of its range
DAMPING_RANGE, DAMPING_RANGE_FAST = 3.3, 1.7  # N·m·s/rad
HALF = DAMPING_RANGE_FAST / DAMPING_RANGE
FAST_HZ, SLOW_HZ = 20_000, 2000

# Thresholds of the rules.
DROP = 0.95  # K may fall by so much from one rate to the next and still count as rising
RISE = 2.0  # K at 20 kHz over that at 2 kHz
LEVEL_OFF = 1.25  # K at 50 kHz over that at 20 kHz: at most
STILL_RISING = 1.6  # the same without what levels it off: at least
LEVEL_FACTOR = 1.65  # of the paper's number, both ways
SAME_RANGE = 1.1  # in simulation
SAME_LINEAR = 1.05  # in linear theory
MOST_PLANTS = 0.9
NUMBER = 1.15  # of the paper's number for a range of damping
HALF_LOW, HALF_HIGH = 0.35, 0.65
HIGHER = 1.05
LESS = 0.9  # of the undamped penetration
LIKE_NONE = 0.95
NOISIER = 3.0
NULL, SEEN = 0.2, 0.5  # of the true velocity


def rises(curves: Mapping[str, Sequence[float]], rates: Sequence[int]) -> Finding:
    """K_max over the rate, by rig."""
    cases, said = {}, []
    for name, stiffness in curves.items():
        by_rate = dict(zip(rates, stiffness, strict=True))
        ratio = over(by_rate[FAST_HZ], by_rate[SLOW_HZ])
        up = all(high >= DROP * low for low, high in pairwise(k for r, k in by_rate.items() if r <= FAST_HZ))
        cases[name] = up and ratio >= RISE
        said.append(f"{name}: {shown(by_rate[SLOW_HZ])} at 2 kHz, {shown(by_rate[FAST_HZ])} at 20 kHz")
    return verdict_over(cases, "; ".join(said))


def levels_off(with_lag: Mapping[str, float | None], without_lag: Mapping[str, float | None]) -> Finding:
    """K at 50 kHz over that at 20 kHz, with the electrical lag and without; None where a search hit its cap."""
    levels = {name: r is not None and r <= LEVEL_OFF for name, r in with_lag.items()}
    free = {name: r is None or r >= STILL_RISING for name, r in without_lag.items()}
    ours = "K(50 kHz)/K(20 kHz) " + "; ".join(
        f"{name} {grown(with_lag[name])} with the lag, {grown(without_lag[name])} without" for name in levels
    )
    found = verdict_over(levels, ours)
    if found.status is Status.REPRODUCED and any(free.values()):
        return Finding(status=Status.ONLY_WITH, ours=ours, condition="the electrical lag")
    return found


def near(values: Mapping[str, float], target: float, factor: float, unit: str, *, unfitted: str) -> Finding:
    """Whether numbers are near the paper's; on the rig that is not fitted, that is a confirmation."""
    ours = "; ".join(f"{name} {shown(value)}" for name, value in values.items()) + f" {unit}"
    cases = {name: within(value, target, factor) for name, value in values.items()}
    return verdict_over(cases, ours, unconditional=[unfitted] if cases.get(unfitted) else [])


def same(ratios: Mapping[str, float], linear: Mapping[str, float], step: float = 1.0) -> Finding:
    """Range of the dual-rate wall over that of the slow uniform one, simulated (`step` apart) and linear."""
    cases = {name: within(ratio, 1.0, SAME_RANGE * step) for name, ratio in ratios.items()}
    cases |= {f"theory, {name}": within(ratio, 1.0, SAME_LINEAR) for name, ratio in linear.items()}
    ours = (
        f"ratio {shown(min(ratios.values()))} to {shown(max(ratios.values()))} in {len(ratios)} simulated cases, "
        f"{shown(min(linear.values()), 4)} to {shown(max(linear.values()), 4)} in linear theory"
    )
    found = verdict_over(cases, ours)
    if found.status is not Status.ONLY_WITH:
        return found
    failing = [name for name, holds in cases.items() if not holds]
    return Finding(
        status=Status.ONLY_WITH,
        ours=ours,
        condition=f"{len(cases) - len(failing)} of {len(cases)} cases; not with {'; '.join(failing)}",
    )


def same_of_plants(ranges: Sequence[tuple[float, float]]) -> Finding:
    """Ranges of the dual-rate and of the slow uniform wall on random plants."""
    equal = sum(within(over(dual, slow), 1.0, SAME_LINEAR) for dual, slow in ranges)
    share = equal / len(ranges)
    ours = f"{equal} of {len(ranges)} plants within {100 * (SAME_LINEAR - 1):.0f} % ({100 * share:.0f} %)"
    return verdict_over({"": share >= MOST_PLANTS}, ours)


def half(ratios: Mapping[str, float]) -> Finding:
    """Range of the fast uniform wall over that of the dual-rate one, by case."""
    ours = (
        f"{shown(min(ratios.values()))} to {shown(max(ratios.values()))} over {len(ratios)} cases "
        f"(paper {shown(HALF)})"
    )
    return verdict_over({name: HALF_LOW <= ratio <= HALF_HIGH for name, ratio in ratios.items()}, ours)


def half_of_plants(ranges: Sequence[tuple[float, float]]) -> Finding:
    """Ranges of the fast uniform and the dual-rate wall on random plants, by linear theory."""
    ratios = [over(fast, dual) for fast, dual in ranges]
    less = sum(ratio <= HALF_HIGH for ratio in ratios) / len(ratios)
    about = sum(HALF_LOW <= ratio <= HALF_HIGH for ratio in ratios) / len(ratios)
    ours = f"about half in {100 * about:.0f} % of {len(ratios)} plants, at most {HALF_HIGH:g} in {100 * less:.0f} %"
    if less >= MOST_PLANTS:
        return Finding(status=Status.REPRODUCED, ours=ours)
    if less > 0.0:
        return Finding(
            status=Status.ONLY_WITH,
            ours=ours,
            condition=f"some plants ({100 * less:.0f} % have such a range or less)",
        )
    return Finding(status=Status.NOT, ours=ours)


def higher_peak(ratios: Mapping[str, float]) -> Finding:
    """Peak of the dual-rate wall over that of the fast uniform one, by case."""
    ours = (
        f"{shown(min(ratios.values()))} to {shown(max(ratios.values()))} times, over {len(ratios)} cases "
        f"(paper {shown(PEAK_DUAL / LEVEL)})"
    )
    return verdict_over({name: ratio >= HIGHER for name, ratio in ratios.items()}, ours)


def lower_penetration(peaks: Mapping[str, tuple[float, float, float]]) -> Finding:
    """Peaks with no, uniform and dual-rate damping: dual-rate is the lowest, and clearly below none."""
    cases = {
        name: dual <= LESS * none and dual <= LESS * uniform for name, (none, uniform, dual) in peaks.items()
    }
    return verdict_over(cases, counts(peaks))


def like_none(peaks: Mapping[str, tuple[float, float, float]]) -> Finding:
    """Peaks as above: the uniform wall goes as deep as the undamped one."""
    return verdict_over(
        {name: uniform >= LIKE_NONE * none for name, (none, uniform, _) in peaks.items()}, counts(peaks)
    )


def noisier(fast: Mapping[str, float], slow: float) -> Finding:
    """Noise of a count in the velocity at 20 kHz, by cut-off, and at 2 kHz (rad/s rms)."""
    ours = f"2 kHz {shown(slow)} rad/s; " + "; ".join(
        f"{name} {shown(noise)} ({times(over(noise, slow))})" for name, noise in fast.items()
    )
    return verdict_over({name: over(noise, slow) >= NOISIER for name, noise in fast.items()}, ours)


def null_late(readings: Mapping[str, tuple[float, float]]) -> Finding:
    """Share of the true velocity that is read late in the impact at 20 and at 2 kHz, by case.

    A null reading at 20 kHz that is one at 2 kHz as well would say nothing about the rate.
    """
    return verdict_over(
        {name: fast <= NULL < slow for name, (fast, slow) in readings.items()}, read(readings)
    )


def null_late_only(readings: Mapping[str, tuple[float, float]]) -> Finding:
    """Share of the true velocity that is read at 20 kHz early and late in the impact, by case: seen, then not."""
    return verdict_over(
        {name: late <= NULL and early >= SEEN for name, (early, late) in readings.items()}, read(readings)
    )


def read(readings: Mapping[str, tuple[float, float]]) -> str:
    """Two shares of each case in percent, equal ones once."""
    return (
        gathered({name: " / ".join(f"{100 * share:.0f}" for share in of) for name, of in readings.items()})
        + " %"
    )


def gathered(texts: Mapping[str, str]) -> str:
    """Each text once, with the cases that it belongs to."""
    by_text: dict[str, list[str]] = {}
    for name, text in texts.items():
        by_text.setdefault(text, []).append(name)
    return "; ".join(f"{', '.join(names)}: {text}" for text, names in by_text.items())


def grown(ratio: float | None) -> str:
    """A ratio in words; None: a search hit its cap."""
    return "beyond the search" if ratio is None else shown(ratio)


def counts(peaks: Mapping[str, tuple[float, float, float]]) -> str:
    """None / uniform / dual of each case, equal ones once."""
    texts = {name: " / ".join(shown(value) for value in values) for name, values in peaks.items()}
    return gathered(texts) + " counts"
