"""Sections on Koul et al. about theory: the linear loop, what friction and quantiser make of it, and random plants."""

from __future__ import annotations

from typing import Any

import numpy as np

from rig.papers.frame import Picture, Section, Table, shown, within
from rig.papers.koul.parts import LAGS_S, PLANT_RANGES
from rig.papers.koul.results import Effect, Koul
from rig.papers.koul.rigs import (
    COMPLIANT,
    DUAL,
    EFFECTS,
    FAST,
    FAST_1K,
    LABELS,
    LOWEST_STIFFNESS,
    MAIN,
    NAMES,
    SCHEMES,
    SLOW,
)
from rig.papers.koul.rules import SAME_LINEAR
from rig.papers.koul.words import ORDER, of_linear, offsets, percent


def theory(koul: Koul) -> Section:
    """K_max over B and passivity, of the linear loop."""
    rows, said = [], []
    for held in MAIN:
        of = koul.linear[held.name]
        for key, linear in of.items():
            rows.append(
                (
                    f"{NAMES[held.preset]}, {LABELS[key]}",
                    shown(linear["undamped"]),
                    shown(linear["peak"]),
                    shown(linear["range"]),
                    shown(linear["range_with_islands"]),
                    shown(linear["beta"]),
                    shown(linear["passive_stiffness"]),
                    shown(linear["passive_damping"]),
                )
            )
        said.append(
            f"{NAMES[held.preset]}: at B = 0 the dual-rate wall has "
            f"{shown(of[DUAL]['undamped'] / of[SLOW]['undamped'])} "
            f"times the stiffness of the 2 kHz one; their ranges of damping are "
            f"{shown(of[DUAL]['range'], 4)} and {shown(of[SLOW]['range'], 4)}; the uniform 20 kHz wall has "
            f"{shown(of[FAST]['range'] / of[DUAL]['range'])} times that range with a 2 kHz filter and "
            f"{shown(of[FAST_1K]['range'] / of[DUAL]['range'])} with a 1 kHz one."
        )
    head = (
        "rig, scheme",
        "K at B = 0",
        "peak K",
        "range of B",
        "with islands",
        "β",
        "passive K at B = 0",
        "passive B at K = 0",
    )
    return Section(
        key="theory",
        title="The theory that the paper leaves open",
        text=(
            *said,
            "Passivity, b ≥ K·(T1/2 + lag) + β·B, is necessary for a wall that any hand may touch; the curves are "
            "what is stable in this one.",
        ),
        conditions=(
            "Exact lifting over T2 of plant, normal hand, lag, hold and estimator; no friction, no "
            "quantiser, no saturation, "
            "no release. A scan of K from that on which the rig swings at 1 Hz. Passivity counts the "
            "damping of the rig alone.",
        ),
        pictures=(Picture("theory", "K_max over B of the linear loop."),),
        tables=(Table("K in N·m/rad, B in N·m·s/rad", head, tuple(rows)),),
    )


def effects(koul: Koul) -> Section:
    """Friction and quantiser, apart and together."""
    linear, rows = koul.linear[MAIN[0].name], []
    for name in EFFECTS:
        effect = koul.effects[name]
        rows.append(
            (
                name,
                *(of_linear(effect.undamped[key], linear[key]["undamped"]) for key in (DUAL, SLOW)),
                *(of_linear(effect.ranges[key]["any"].damping, linear[key]["range"]) for key in SCHEMES),
            )
        )
    control, friction, quantiser, both = (koul.effects[name] for name in EFFECTS)

    def undamped(effect: Effect, key: str = DUAL) -> str:
        return shown(effect.undamped[key] / linear[key]["undamped"])

    def ranges(effect: Effect, key: str) -> str:
        return shown(effect.ranges[key]["any"].damping / linear[key]["range"])

    head = (
        "left in",
        "K at B = 0, 20 kHz",
        "K at B = 0, 2 kHz",
        *(f"range, {LABELS[key]}" for key in SCHEMES),
    )
    return Section(
        key="effects",
        title="What friction and the quantiser do to the linear limits",
        text=(
            f"Without both, simulation over linear theory is {undamped(control)} in K at B = 0 (20 kHz) and "
            f"{ranges(control, DUAL)} in the range of the dual-rate wall, which checks one against the other.",
            f"K at B = 0, over linear: friction alone {undamped(friction)}, quantiser alone "
            f"{undamped(quantiser)}, both "
            f"{undamped(both)}.",
            f"Range of the dual-rate wall, over linear: friction alone {ranges(friction, DUAL)}, quantiser alone "
            f"{ranges(quantiser, DUAL)}, both {ranges(both, DUAL)}; of the uniform 20 kHz wall (2 kHz): "
            f"{ranges(friction, FAST)}, {ranges(quantiser, FAST)}, {ranges(both, FAST)}.",
        ),
        conditions=(
            f"{NAMES[COMPLIANT]}, normal hand. No quantiser: 64,000 lines × 4, current in steps of 0.2 mA. Trials of "
            f"{koul.scale.effect_s:g} s, because what grows slowly is seen late. K at B = 0: not felt. Ranges: walls "
            f"of {LOWEST_STIFFNESS:g} N·m/rad neither felt nor heard nor moved, bisection in B, rungs "
            f"{percent(koul.scale.range_ratio)} apart, {offsets(koul)}.",
        ),
        pictures=(Picture("effects", "Limits with and without friction and quantiser."),),
        tables=(Table("value (over linear theory); K in N·m/rad, B in N·m·s/rad", head, tuple(rows)),),
    )


def plants(koul: Koul) -> Section:
    """Ranges of damping on random plants."""
    ranges = np.array([plant["ranges"] for plant in koul.plants])
    fast = ranges[:, ORDER.index(FAST)] / np.maximum(ranges[:, ORDER.index(DUAL)], 1e-9)
    connected = ranges[:, ORDER.index(DUAL)] / ranges[:, ORDER.index(SLOW)]
    whole = np.array([plant["with_islands"][0] / plant["with_islands"][1] for plant in koul.plants])
    quartiles = ", ".join(shown(float(q)) for q in np.percentile(fast, (25, 50, 75)))
    drawn = "; ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in PLANT_RANGES.items())
    return Section(
        key="plants",
        title="Random plants",
        text=(
            f"Over {len(fast)} plants the uniform 20 kHz wall has a median of "
            f"{quartiles.split(', ')[1]} times the range of the "
            f"dual-rate wall (quartiles {quartiles.split(', ')[0]} and {quartiles.split(', ')[2]}); a "
            f"larger range than "
            f"dual-rate on {100 * float((fast > 1.0).mean()):.0f} % of them.",
            f"Dual-rate and uniform 2 kHz walls have the same range on {100 * _equal(connected):.0f} "
            f"% of the plants, counting "
            f"only what is connected with soft walls, and on {100 * _equal(whole):.0f} % counting "
            f"islands of stiffer walls "
            "that hold beyond it.",
        ),
        conditions=(
            f"Linear theory, two masses, drawn log-uniformly (SI): {drawn}; lag {LAGS_S[0]:g} to "
            f"{LAGS_S[1]:g} s; held by "
            "one of the three hands or nobody.",
        ),
        pictures=(Picture("plants", "Each point is a plant."),),
    )


def _equal(ratios: Any) -> float:
    """Share of ratios that are one within the rule's tolerance."""
    return float(np.mean([within(ratio, 1.0, SAME_LINEAR) for ratio in ratios]))
