"""The claims of Koul et al. with their verdicts: which numbers of the results go into which rule."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rig.control.verdict import CRITERIA
from rig.papers.frame import Claim, Finding, Status, over, shown, verdict_over, within
from rig.papers.koul import rules
from rig.papers.koul import ways as koul_ways
from rig.papers.koul.compare import FLOAT
from rig.papers.koul.results import Koul
from rig.papers.koul.rigs import (
    COMPLIANT,
    DUAL,
    FAST,
    FAST_1K,
    HELD,
    MAIN,
    NAMES,
    PRESETS,
    RIGID,
    SCHEMES,
    SLOW,
    WITH_LAG,
    WITHOUT_LAG,
)


def claims(koul: Koul) -> tuple[Claim, ...]:
    """Every claim with its verdict."""
    return (
        _rises(koul),
        _levels_off(koul),
        _level(koul),
        _same_range(koul),
        _same_range_of_plants(koul),
        _range_number(koul),
        _half(koul),
        _half_of_plants(koul),
        _higher_peak(koul),
        _peak_number(koul),
        _left_at_range(koul),
        _penetration(koul),
        _like_none(koul),
        _noisier(koul),
        _null(koul),
        _null_late_only(koul),
    )


def _rises(koul: Koul) -> Claim:
    rates = koul.scale.rates
    curves = {NAMES[p]: [b.stiffness for b in koul.kmax[p, WITH_LAG].curve("any")] for p in PRESETS}
    return Claim(
        key="rises",
        claim="K_max at B = 0 rises with the sampling rate (Fig. 5)",
        paper="rising up to 20 kHz",
        finding=rules.rises(curves, rates),
        needs="nothing",
        rule=f"each rate up to 20 kHz holds at least {rules.DROP:g} of the one before, "
        f"and 20 kHz at least {rules.RISE:g} times 2 kHz",
    )


def _levels_off(koul: Koul) -> Claim:
    def ratios(lag: str) -> dict[str, float | None]:
        return {NAMES[p]: koul.kmax[p, lag].saturation("any") for p in PRESETS}

    return Claim(
        key="levels-off",
        claim="K_max saturates above 20 kHz (Fig. 5)",
        paper="no gain above 20 kHz",
        finding=rules.levels_off(ratios(WITH_LAG), ratios(WITHOUT_LAG)),
        needs="a lag that does not shrink with T1: the motor's inductance or its current loop",
        rule=f"K(50 kHz)/K(20 kHz) at most {rules.LEVEL_OFF:g}; only with the lag if it is "
        f"{rules.STILL_RISING:g} or more (or beyond the search) on some rig without it",
    )


def _level(koul: Koul) -> Claim:
    at = koul.scale.rates.index(rules.FAST_HZ)
    values = {NAMES[p]: koul.kmax[p, WITH_LAG].curve("any")[at].stiffness for p in PRESETS}
    return Claim(
        key="level",
        claim="K_max at 20 kHz, B = 0",
        paper=f"{rules.LEVEL:g} N·m/rad",
        finding=rules.near(values, rules.LEVEL, rules.LEVEL_FACTOR, "N·m/rad", unfitted=NAMES[RIGID]),
        needs="×4 decoding; friction and its split between motor and link move it",
        rule=f"within a factor {rules.LEVEL_FACTOR:g}; a rig that is not fitted decides alone",
    )


def _same_range(koul: Koul) -> Claim:
    simulated = {
        f"{name}, {criterion}": over(of[DUAL][criterion].damping, of[SLOW][criterion].damping)
        for name, of in koul.ranges.items()
        for criterion in CRITERIA
    }
    linear = {name: over(of[DUAL]["range"], of[SLOW]["range"]) for name, of in koul.linear.items()}
    return Claim(
        key="same-range",
        claim="the dual-rate wall has the range of damping of the uniform 2 kHz wall (Fig. 6)",
        paper="3.3 and 3.3 N·m·s/rad",
        finding=rules.same(simulated, linear, koul.scale.range_ratio),
        needs="nothing: T2, its filter and the inertia set the range",
        rule=f"ratio within {100 * (rules.SAME_RANGE - 1):.0f} % and a rung in every simulated case "
        "(rigs, hands, criteria), within "
        f"{100 * (rules.SAME_LINEAR - 1):.0f} % in linear theory",
    )


def _same_range_of_plants(koul: Koul) -> Claim:
    order = list(SCHEMES)
    pairs = [(p["ranges"][order.index(DUAL)], p["ranges"][order.index(SLOW)]) for p in koul.plants]
    return Claim(
        key="same-range-plants",
        claim="the same on random plants, by linear theory",
        paper="(one rig)",
        finding=rules.same_of_plants(pairs),
        needs="nothing",
        rule=f"ratio within {100 * (rules.SAME_LINEAR - 1):.0f} % "
        f"on at least {100 * rules.MOST_PLANTS:.0f} % of the plants",
    )


def _range_number(koul: Koul) -> Claim:
    values: dict[str, float] = {}
    dual = list(SCHEMES).index(DUAL)
    for held in MAIN:
        rig, found = _short(held.preset), koul.maps[held.name]
        for criterion in ("felt", "heard"):
            values[f"{rig}, soft wall, {criterion}"] = koul.ranges[held.name][DUAL][criterion].damping
            if found.plan.search.way == "grid":
                columns = koul_ways.columns(found, dual, criterion)
                values[f"{rig}, any wall, {criterion}"] = max(c.damping for c in columns if c.highest > 0.0)
        values[f"{rig}, theory"] = koul.linear[held.name][DUAL]["range"]
    return Claim(
        key="range",
        claim="that range",
        paper=f"{rules.DAMPING_RANGE:g} N·m·s/rad",
        finding=rules.near(values, rules.DAMPING_RANGE, rules.NUMBER, "N·m·s/rad", unfitted=""),
        needs="an inertia at the link of 1.5 to 2 g·m² and a capstan of 2 to 3 kN·m/rad, both fitted",
        rule=f"within {100 * (rules.NUMBER - 1):.0f} %; "
        "a soft wall is the softest of the map, any wall the largest damping at "
        "which some stiffness of the map holds",
    )


def _half(koul: Koul) -> Claim:
    ratios = {
        f"{_short(held.preset)}, {_cutoff(fast)}, {criterion}": over(
            koul.ranges[held.name][fast][criterion].damping, koul.ranges[held.name][DUAL][criterion].damping
        )
        for held in MAIN
        for fast in (FAST, FAST_1K)
        for criterion in CRITERIA
    }
    ratios |= {
        f"{_short(held.preset)}, {_cutoff(fast)}, theory": over(
            koul.linear[held.name][fast]["range"], koul.linear[held.name][DUAL]["range"]
        )
        for held in MAIN
        for fast in (FAST, FAST_1K)
    }
    return Claim(
        key="half",
        claim="the uniform 20 kHz wall has half the range of damping of the dual-rate wall (Fig. 6)",
        paper=f"{rules.DAMPING_RANGE_FAST:g} of {rules.DAMPING_RANGE:g} N·m·s/rad",
        finding=rules.half(ratios),
        needs="an elastic capstan and the lag, or the noise of a count: the linear rigid rig says the opposite",
        rule=f"ratio of {rules.HALF_LOW:g} to {rules.HALF_HIGH:g}, in each rig, cut-off and criterion",
    )


def _half_of_plants(koul: Koul) -> Claim:
    order = list(SCHEMES)
    pairs = [(p["ranges"][order.index(FAST)], p["ranges"][order.index(DUAL)]) for p in koul.plants]
    return Claim(
        key="half-plants",
        claim="the same on random plants, by linear theory",
        paper="(one rig)",
        finding=rules.half_of_plants(pairs),
        needs="a plant whose capstan mode the 200 Hz filter quiets and the 2 kHz one does not",
        rule=f"at most {rules.HALF_HIGH:g} on at least {100 * rules.MOST_PLANTS:.0f} % of the plants",
    )


def _higher_peak(koul: Koul) -> Claim:
    order, ratios = list(SCHEMES), {}
    for held in HELD:
        found = koul.maps[held.name]
        for fast in (FAST, FAST_1K):
            for criterion in CRITERIA:
                peaks = [found.width(order.index(key), criterion).stiffness_peak for key in (DUAL, fast)]
                ratios[f"{_short(held.preset)}, {held.push}, {_cutoff(fast)}, {criterion}"] = over(*peaks)
    return Claim(
        key="higher-peak",
        claim="the dual-rate wall is stiffer at its best than the uniform 20 kHz wall (Fig. 6)",
        paper=f"{rules.PEAK_DUAL:g} against {rules.LEVEL:g} N·m/rad",
        finding=_by_group(rules.higher_peak(ratios), ratios),
        needs="compliance and an inertia at the link above 0.8 g·m², both fitted",
        rule=f"ratio of the peaks at least {rules.HIGHER:g}, in each rig, hand, cut-off and criterion",
    )


def _by_group(found: Finding, ratios: Mapping[str, float]) -> Finding:
    """Say in how many cases of each rig and cut-off a claim holds, instead of listing dozens."""
    if found.status is not Status.ONLY_WITH:
        return found
    groups: dict[str, list[bool]] = {}
    for name, ratio in ratios.items():
        rig, _, cutoff, _ = name.split(", ")
        groups.setdefault(f"{rig}, {cutoff}", []).append(ratio >= rules.HIGHER)
    said = [f"{name} ({sum(held)} of {len(held)} cases)" for name, held in groups.items() if any(held)]
    return Finding(status=found.status, ours=found.ours, condition="; ".join(said))


def _peak_number(koul: Koul) -> Claim:
    order, cases, said = list(SCHEMES), {}, []
    for held in MAIN:
        for fast in (FAST, FAST_1K):
            wanted = {DUAL: rules.PEAK_DUAL, fast: rules.LEVEL, SLOW: rules.PEAK_SLOW}
            peaks = {
                key: koul.maps[held.name].width(order.index(key), "any").stiffness_peak for key in wanted
            }
            name = f"{_short(held.preset)}, {_cutoff(fast)}"
            cases[name] = all(
                within(peaks[key], target, rules.LEVEL_FACTOR) for key, target in wanted.items()
            )
            said.append(f"{name}: " + " / ".join(shown(k) for k in peaks.values()))
    return Claim(
        key="peaks",
        claim="peaks of dual-rate, uniform 20 kHz and uniform 2 kHz walls",
        paper=f"{rules.PEAK_DUAL:g} / {rules.LEVEL:g} / {rules.PEAK_SLOW:g} N·m/rad",
        finding=verdict_over(cases, "; ".join(said) + " N·m/rad"),
        needs="the cut-off of the uniform 20 kHz wall, which the paper does not decide",
        rule=f"all three within a factor {rules.LEVEL_FACTOR:g}, neither felt nor heard nor moved",
    )


def _left_at_range(koul: Koul) -> Claim:
    order, values = list(SCHEMES), {}
    for held in MAIN:
        curve = koul.maps[held.name].curve(order.index(DUAL), "any")
        at = min(curve, key=lambda boundary: abs(boundary.damping - rules.DAMPING_RANGE))
        values[f"{NAMES[held.preset]} (B = {at.damping:.2f})"] = at.stiffness
    return Claim(
        key="left-at-range",
        claim="stiffness of the dual-rate wall at B = 3.3 N·m·s/rad",
        paper=f"{rules.DUAL_AT_RANGE:g} N·m/rad",
        finding=rules.near(values, rules.DUAL_AT_RANGE, rules.LEVEL_FACTOR, "N·m/rad", unfitted=""),
        needs="a range of damping beyond 3.3",
        rule=f"within a factor {rules.LEVEL_FACTOR:g}, at the damping of the map that is nearest",
    )


def _peaks_of_figure_7(koul: Koul) -> dict[str, tuple[float, float, float]]:
    return {f"{p.position_rate / 1e3:g} kHz, {p.arithmetic}": p.peaks for p in koul.figure_7}


def _penetration(koul: Koul) -> Claim:
    return Claim(
        key="penetration",
        claim="the first impact goes less deep with dual-rate than with uniform or no damping (Fig. 7)",
        paper="lowest of the three",
        finding=rules.lower_penetration(_peaks_of_figure_7(koul)),
        needs="fixed point with few bits of state, rounding towards zero; the paper gives no word length",
        rule=f"dual-rate peak at most {rules.LESS:g} of both others, in each panel",
    )


def _like_none(koul: Koul) -> Claim:
    by_panel = _peaks_of_figure_7(koul)
    peaks = {FLOAT: by_panel[f"20 kHz, {FLOAT}"]}
    for row in koul.words:
        name = _word(row)
        none, uniform, dual = (row[kind][str(rules.FAST_HZ)] for kind in ("none", "uniform", "dual"))
        peaks[name] = (none, uniform, dual)
    return Claim(
        key="like-none",
        claim="at 20 kHz uniform damping does no more than none (Fig. 7)",
        paper="equal curves",
        finding=_by_words(rules.like_none(peaks)),
        needs="a filter whose state rounds slow motion to rest: few fractional bits, truncation towards zero",
        rule=f"uniform peak at least {rules.LIKE_NONE:g} of the undamped one, "
        "in floating point and at each word length",
    )


def _by_words(found: Finding) -> Finding:
    """Gather the word lengths in a condition by cut-off."""
    cutoffs: dict[str, list[str]] = {}
    for case in found.condition.split("; ") if found.condition else []:
        bits, _, cutoff = case.partition(" bits, ")
        cutoffs.setdefault(cutoff, []).append(bits)
    said = "; ".join(
        f"fixed point, {', '.join(bits)} bits of state with {cutoff}" if cutoff else bits[0]
        for cutoff, bits in cutoffs.items()
    )
    return Finding(status=found.status, ours=found.ours, condition=said)


def _noisier(koul: Koul) -> Claim:
    fast = {name: noise for name, noise in koul.noise.items() if name.startswith("20 kHz")}
    return Claim(
        key="noisier",
        claim="velocity estimated at 20 kHz is noisier than at 2 kHz early in the impact (Fig. 8a)",
        paper="considerable noise",
        finding=rules.noisier(fast, koul.noise["2 kHz"]),
        needs="nothing",
        rule=f"noise at 20 kHz at least {rules.NOISIER:g} times that at 2 kHz, with both cut-offs: "
        "what an estimator makes of "
        "counts less what it makes of the same motion in counts a thousand times finer, floating point",
    )


def _null(koul: Koul) -> Claim:
    profiles = koul.figure_8
    readings = {
        FLOAT: (profiles[rules.FAST_HZ, FLOAT].reading_late, profiles[rules.SLOW_HZ, FLOAT].reading_late)
    }
    for row in koul.words:
        fast, slow = (row["read"][str(rate)]["late"] for rate in (rules.FAST_HZ, rules.SLOW_HZ))
        readings[_word(row)] = (fast, slow)
    return Claim(
        key="null-late",
        claim="late in the impact the velocity at 20 kHz reads nearly nothing (Fig. 8b)",
        paper="nearly null",
        finding=_by_words(rules.null_late(readings)),
        needs="the same word length as Fig. 7",
        rule=f"at most {rules.NULL:g} of the true velocity (rms) at 20 kHz, and more than that at 2 kHz; "
        "numbers are late at 20 / 2 kHz",
    )


def _null_late_only(koul: Koul) -> Claim:
    float_ = koul.figure_8[rules.FAST_HZ, FLOAT]
    readings = {FLOAT: (float_.reading_early, float_.reading_late)}
    for row in koul.words:
        read = row["read"][str(rules.FAST_HZ)]
        readings[_word(row)] = (read["early"], read["late"])
    return Claim(
        key="null-late-only",
        claim="the same filter shows the noisy velocity early and nearly nothing late (Fig. 8a and 8b together)",
        paper="one filter",
        finding=_by_words(rules.null_late_only(readings)),
        needs="a velocity that is rounded away when slow but not when fast: none of these filters does that",
        rule=f"at 20 kHz at least {rules.SEEN:g} of the true velocity (rms) early, at most {rules.NULL:g} late; "
        "numbers are early / late at 20 kHz",
    )


def _word(row: Mapping[str, Any]) -> str:
    return f"{row['state_bits']} bits, fs/{1 / row['uniform_share']:g}"


def _short(preset: str) -> str:
    return {COMPLIANT: "compliant (fitted)", RIGID: "rigid"}[preset]


def _cutoff(key: str) -> str:
    return {FAST: "2 kHz", FAST_1K: "1 kHz"}[key]
