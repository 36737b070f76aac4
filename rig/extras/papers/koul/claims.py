"""Judge the claims of Koul et al.: pass the computed numbers to the rule of each claim (`rules` in this folder).

`reproduction` uses it. Thresholds are in `rules`, sentences in ``claims.j2``.
"""

from collections.abc import Sequence
from typing import Any

from rig.control.verdict import CRITERIA
from rig.extras.papers.koul import rigs, rules
from rig.extras.papers.koul.compare import FLOAT
from rig.extras.papers.koul.results import Koul, word_name
from rig.extras.papers.koul.ways import columns
from rig.extras.papers.rules import Ruling, over

RIGS = {rigs.COMPLIANT: "compliant (fitted)", rigs.RIGID: "rigid"}
CUTOFFS = {rigs.FAST: "2 kHz", rigs.FAST_1K: "1 kHz"}  # of the uniform 20 kHz wall
NUMBERS = {key: number for number, key in enumerate(rigs.SCHEMES)}


def rulings(koul: Koul) -> dict[str, Ruling]:
    """Judge every claim of the paper; return the ruling (verdict and its numbers) by the claim's key."""
    k_max = {
        rigs.NAMES[panel]: [b.stiffness for b in koul.kmax[panel, rigs.WITH_LAG].curve("any")]
        for panel in rigs.PRESETS
    }
    at_fast = koul.scale.rates.index(rules.FAST_HZ)
    panels = {
        f"{panel.position_rate / 1e3:g} kHz, {panel.arithmetic}": panel.peaks for panel in koul.figure_7
    }
    return {
        "rises": rules.rises(k_max, koul.scale.rates, koul.scale.kmax_ratio),
        "levels-off": rules.levels_off(
            _saturation_by_rig(koul, rigs.WITH_LAG),
            _saturation_by_rig(koul, rigs.WITHOUT_LAG),
            koul.scale.kmax_ratio,
        ),
        "level": rules.level(
            {name: curve[at_fast] for name, curve in k_max.items()}, rules.LEVEL, koul.scale.kmax_ratio
        ),
        "same-range": _same_range(koul),
        "same-range-plants": rules.same_of_plants(_dampings_of_plants(koul, rigs.DUAL, rigs.SLOW)),
        "range": rules.near(
            _damping_ranges(koul), rules.DAMPING_RANGE, rules.NUMBER * koul.scale.range_ratio
        ),
        "half": rules.half(_fast_damping_ratios(koul), koul.scale.range_ratio),
        "half-plants": rules.half_of_plants(_dampings_of_plants(koul, rigs.FAST, rigs.DUAL)),
        "fast-loses": rules.loses(_curves_of_fast(koul), koul.scale.ratio),
        "slow-first-rises": rules.first_rises(_curves_of_slow(koul), koul.scale.ratio),
        "higher-peak": rules.higher_peak(_peak_ratios(koul), koul.scale.ratio),
        "peaks": _peaks(koul),
        "left-at-range": _stiffness_at_range(koul),
        "penetration": rules.lower_penetration(panels),
        "oscillation": rules.lower_penetration(
            {
                f"{panel.position_rate / 1e3:g} kHz, {panel.arithmetic}": panel.decays
                for panel in koul.figure_7
            }
        ),
        "between": rules.between({name: of for name, of in panels.items() if name.startswith("10 kHz")}),
        "like-none": rules.like_none({FLOAT: panels[f"20 kHz, {FLOAT}"], **_peaks_by_word(koul)}),
        "lower-cutoff": rules.sometimes_better(koul.lower_cutoffs),
        "best-below": rules.best_below({(name, rate): (f, d) for name, rate, f, d in koul.differentiators}),
        "filter-delay": rules.filter_delay(rules.FILTER_DELAYS_S),
        "noisier": rules.noisier(
            {name: noise for name, noise in koul.noise.items() if name.startswith("20 kHz")},
            koul.noise["2 kHz"],
        ),
        "null-late": _null_late(koul),
        "null-late-only": _null_late_only(koul),
    }


def by_cutoff(names: Sequence[str]) -> list[tuple[str, list[str]]]:
    """Group names such as "4 bits, fs/20" by cut-off; return (cut-off, word lengths), with "" for floating point."""
    cutoffs: dict[str, list[str]] = {}
    for name in names:
        bits, _, cutoff = name.partition(" bits, ")
        cutoffs.setdefault(cutoff, []).append(bits)
    return list(cutoffs.items())


def _saturation_by_rig(koul: Koul, lag: str) -> dict[str, float | None]:
    return {rigs.NAMES[preset]: koul.kmax[preset, lag].saturation("any") for preset in rigs.PRESETS}


def _dampings_of_plants(koul: Koul, *keys: str) -> list[tuple[float, float]]:
    first, second = (NUMBERS[key] for key in keys)
    return [(plant["ranges"][first], plant["ranges"][second]) for plant in koul.plants]


def _same_range(koul: Koul) -> Ruling:
    simulated = {
        f"{name}, {criterion}": over(of[rigs.DUAL][criterion].damping, of[rigs.SLOW][criterion].damping)
        for name, of in koul.ranges.items()
        for criterion in CRITERIA
    }
    linear = {name: over(of[rigs.DUAL]["range"], of[rigs.SLOW]["range"]) for name, of in koul.linear.items()}
    return rules.same(simulated, linear, koul.scale.range_ratio)


def _damping_ranges(koul: Koul) -> dict[str, float]:
    values: dict[str, float] = {}
    for held in rigs.MAIN:
        rig, found = RIGS[held.preset], koul.maps[held.name]
        for criterion in ("felt", "heard"):
            soft = koul.ranges[held.name][rigs.DUAL][criterion].damping
            values[f"{rig}, soft wall, {criterion}"] = soft
            if found.plan.search.way == "grid":
                damped = [c.damping for c in columns(found, NUMBERS[rigs.DUAL], criterion) if c.highest > 0.0]
                values[f"{rig}, any wall, {criterion}"] = max(soft, *damped)
        values[f"{rig}, theory"] = koul.linear[held.name][rigs.DUAL]["range"]
    return values


def _fast_damping_ratios(koul: Koul) -> dict[tuple[str, str, str], float]:
    ratios = {}
    for held in rigs.MAIN:
        simulated, linear = koul.ranges[held.name], koul.linear[held.name]
        for fast, cutoff in CUTOFFS.items():
            case = RIGS[held.preset], cutoff
            for criterion in CRITERIA:
                ranges = (simulated[key][criterion].damping for key in (fast, rigs.DUAL))
                ratios[*case, criterion] = over(*ranges)
            ratios[*case, "theory"] = over(linear[fast]["range"], linear[rigs.DUAL]["range"])
    return ratios


def _curves(koul: Koul, held: rigs.HeldRig, key: str) -> dict[str, rules.Curve]:
    found = koul.maps[held.name]
    simulated = {
        criterion: [(limit.damping, limit.stiffness) for limit in found.curve(NUMBERS[key], criterion)]
        for criterion in CRITERIA
    }
    return {**simulated, "theory": [(b, k) for b, k in koul.linear[held.name][key]["curve"]]}


def _curves_of_fast(koul: Koul) -> dict[tuple[str, str, str], rules.Curve]:
    return {
        (RIGS[held.preset], cutoff, reading): curve
        for held in rigs.MAIN
        for fast, cutoff in CUTOFFS.items()
        for reading, curve in _curves(koul, held, fast).items()
    }


def _curves_of_slow(koul: Koul) -> dict[tuple[str, str], rules.Curve]:
    return {
        (RIGS[held.preset], reading): curve
        for held in rigs.MAIN
        for reading, curve in _curves(koul, held, rigs.SLOW).items()
    }


def _peak_ratios(koul: Koul) -> dict[tuple[str, str, str, str], float]:
    return {
        (RIGS[held.preset], held.push, CUTOFFS[fast], criterion): over(
            *(koul.width(held, key, criterion).stiffness_peak for key in (rigs.DUAL, fast))
        )
        for held in rigs.HELD
        for fast in (rigs.FAST, rigs.FAST_1K)
        for criterion in CRITERIA
    }


def _peaks(koul: Koul) -> Ruling:
    found = {
        (RIGS[held.preset], cutoff): [
            koul.width(held, key).stiffness_peak for key in (rigs.DUAL, fast, rigs.SLOW)
        ]
        for held in rigs.MAIN
        for fast, cutoff in CUTOFFS.items()
    }
    return rules.peaks(found, (rules.PEAK_DUAL, rules.LEVEL, rules.PEAK_SLOW), koul.scale.ratio)


def _stiffness_at_range(koul: Koul) -> Ruling:
    values = {}
    for held in rigs.MAIN:
        curve = koul.maps[held.name].curve(NUMBERS[rigs.DUAL], "any")
        at = min(curve, key=lambda boundary: abs(boundary.damping - rules.DAMPING_RANGE))
        values[f"{rigs.NAMES[held.preset]} (B = {at.damping:.2f})"] = at.stiffness
    return rules.level(values, rules.DUAL_AT_RANGE, koul.scale.ratio)


def _peaks_by_word(koul: Koul) -> dict[str, tuple[Any, Any, Any]]:
    fast = str(rules.FAST_HZ)
    return {
        word_name(row): (row["none"][fast], row["uniform"][fast], row["dual"][fast]) for row in koul.words
    }


def _null_late(koul: Koul) -> Ruling:
    rates, figure = (rules.FAST_HZ, rules.SLOW_HZ), koul.figure_8
    readings = {FLOAT: tuple(figure[rate, FLOAT].reading_late for rate in rates)}
    readings |= {word_name(row): tuple(row["read"][str(r)]["late"] for r in rates) for row in koul.words}
    return rules.null_late(readings)  # type: ignore[arg-type]  # pairs


def _null_late_only(koul: Koul) -> Ruling:
    profile, rate = koul.figure_8[rules.FAST_HZ, FLOAT], str(rules.FAST_HZ)
    readings = {FLOAT: (profile.reading_early, profile.reading_late)}
    readings |= {
        word_name(row): (row["read"][rate]["early"], row["read"][rate]["late"]) for row in koul.words
    }
    return rules.null_late_only(readings)
