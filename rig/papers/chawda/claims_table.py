"""Claims of Chawda et al. about absolute numbers, the boundary search, and two controls that theory fixes."""

from __future__ import annotations

import math

import numpy as np

from rig.config import presets
from rig.papers.chawda import rules
from rig.papers.chawda.parts import fidelity_without_wall
from rig.papers.chawda.results import Chawda, spread
from rig.papers.chawda.rigs import AKF, ESTIMATORS, FDM, FOAW, HIGHEST_HZ, PRINTED, READINGS, RIG
from rig.papers.frame import Claim, over, shown

BAND = (1.0, 400.0)  # Hz, of the controls


def by_edge(chawda: Chawda) -> dict[float, list[tuple[bool, bool]]]:
    """For each upper edge of the band: whether K-widths and errors are near Table I, reading by reading."""
    fits: dict[float, list[tuple[bool, bool]]] = {high: [] for high in HIGHEST_HZ}
    stiffness = {name: printed.stiffness for name, printed in PRINTED.items()}
    error = {name: printed.worst_fidelity for name, printed in PRINTED.items()}
    for number, of in enumerate(chawda.read):
        fits[READINGS[number % len(READINGS)].high_hz].append(
            (
                rules.near_table({name: width.stiffness for name, width in of.items()}, stiffness),
                rules.near_table({name: _or_zero(width.worst_fidelity) for name, width in of.items()}, error),
            )
        )
    return fits


def _or_zero(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def closed_widths(chawda: Chawda, name: str) -> list[float]:
    """Largest passive stiffness of the closed form over all dampings, by upper edge of the band."""
    return [max(of) for of in chawda.linear[name]["passive"]]


def floors() -> dict[float, float]:
    """Fidelity error without a wall by upper edge of the band: no estimator's maximum can be much below it."""
    mechanics = mass_and_damping()
    return {high: fidelity_without_wall(*mechanics, (1.0, high)) for high in HIGHEST_HZ}


def mass_and_damping() -> tuple[float, float]:
    """Mass and viscous damping of the paper's rig."""
    mechanics = presets.load(RIG).rig.mechanics
    return mechanics.motor_inertia + mechanics.link_inertia, mechanics.motor_damping + mechanics.link_damping


def claim_widths(chawda: Chawda) -> Claim:
    """K-widths of Table I."""
    fits = by_edge(chawda)
    held = sum(widths for of in fits.values() for widths, _ in of)
    total = sum(len(of) for of in fits.values())
    closed = "; ".join(
        f"up to {high:g} Hz "
        + " and ".join(f"{shown(closed_widths(chawda, name)[number] / 1e3)}" for name in (FDM, AKF))
        for number, high in enumerate(HIGHEST_HZ)
    )
    return Claim(
        key="widths",
        claim="the K-widths themselves",
        paper="21 to 36 kN/m",
        finding=rules.share_of(
            held, total, "readings have all four", f"closed form of {FDM} and {AKF}, kN/m: {closed}"
        ),
        needs="a band up to 250 or 300 Hz",
        rule=f"all four within a factor {rules.NEAR_WIDTH:g} of Table I, in at least {100 * rules.MOST:.0f} %",
    )


def claim_errors(chawda: Chawda) -> Claim:
    """Errors of Table I."""
    fits = by_edge(chawda)
    held = sum(errors for of in fits.values() for _, errors in of)
    total = sum(len(of) for of in fits.values())
    least = "; ".join(f"{shown(floor)} up to {high:g} Hz" for high, floor in floors().items())
    return Claim(
        key="errors",
        claim="the fidelity errors themselves",
        paper="294 to 895 N·s/m",
        finding=rules.share_of(held, total, "readings have all four", f"without a wall it is {least}"),
        needs="another upper edge for each estimator: FOAW's 294 wants one below 156 Hz, FDM's 895 one of 474 Hz",
        rule=f"all four within a factor {rules.NEAR_WIDTH:g} of Table I, in at least {100 * rules.MOST:.0f} %",
    )


def claim_both(chawda: Chawda) -> Claim:
    """Both of them from one band."""
    mass, damping = mass_and_damping()
    foaw = PRINTED[FOAW].worst_fidelity
    edge = _edge_of(foaw, mass, damping)
    lowest = {h: min(closed_widths(chawda, n)[i] for n in (FDM, AKF)) for i, h in enumerate(HIGHEST_HZ)}
    largest = max(PRINTED[name].stiffness for name in ESTIMATORS)
    needed = next((high for high, k in lowest.items() if k <= largest), math.inf)
    fits = by_edge(chawda)
    both = {high: (any(w and e for w, e in of), any(w and e for w, e in of)) for high, of in fits.items()}
    said = (
        f"FOAW's {foaw:g} N·s/m wants a band that ends below {edge:.0f} Hz, K-widths of at most "
        f"{shown(largest / 1e3)} kN/m one up to {needed:g} Hz or more (closed form)"
    )
    return Claim(
        key="both",
        claim="one band gives the K-widths and the fidelity errors of Table I",
        paper="one table",
        finding=rules.both_fit(both, said),
        needs="a rig that is not rigid, or different bands",
        rule="some reading has all four K-widths and all four errors within a factor "
        f"{rules.NEAR_WIDTH:g} of Table I",
    )


def _edge_of(error: float, mass: float, damping: float) -> float:
    """Upper edge (Hz) of the band in which the error without a wall is this large."""
    edges = np.arange(2.0, 1000.0)
    errors = [fidelity_without_wall(mass, damping, (1.0, float(edge))) for edge in edges]
    return float(np.interp(error, errors, edges))


def claim_wider(chawda: Chawda) -> Claim:
    """K-widths here over the measured ones."""
    ratios = {
        name: over(spread(chawda.widths(name), "stiffness").mean, PRINTED[name].stiffness)
        for name in ESTIMATORS
    }
    return Claim(
        key="wider",
        claim="Z-widths in simulation are wider than in the experiment (Figs. 7 and 8)",
        paper="wider (no numbers for Fig. 7)",
        finding=rules.wider(ratios),
        needs="modes and lags that the rigid model does not have",
        rule=f"K-width by the main reading at least {rules.WIDER:g} times the measured one of Table I",
    )


def claim_search(chawda: Chawda) -> Claim:
    """Where the boundary search ends."""
    searches = [chawda.search(name, m) for name in ESTIMATORS for m in range(chawda.map.grid.measurements)]
    tests = float(np.mean([len(s.path) for s in searches]))
    columns = len(searches) * len(chawda.map.grid.dampings)
    return Claim(
        key="search",
        claim="the search of Fig. 5 finds the boundary without testing the whole grid",
        paper="a picture",
        finding=rules.traced(
            sum(s.above for s in searches),
            sum(s.below for s in searches),
            sum(s.unseen for s in searches),
            columns,
            f"{tests:.0f} tests on average instead of {searches[0].cells}",
        ),
        needs="a boundary without islands",
        rule=f"it ends at the edge of the connected region at {100 * rules.TRACED:.0f} % of the dampings",
    )


def claim_undamped(chawda: Chawda) -> Claim:
    """K-width at B = 0 without friction and quantum."""
    _, damping = mass_and_damping()
    must = 2.0 * damping * 1000.0
    found = {name: control["stiffness"] for name, control in chawda.controls.items()}
    return Claim(
        key="control-undamped",
        claim="control: without friction and quantum the K-width at B = 0 is 2b/T, whatever the estimator",
        paper="(theory)",
        finding=rules.controlled(found, must, "N/m"),
        needs="nothing",
        rule=f"within {100 * rules.SAME_CONTROL:g} %, strictly ±90°, lines of 1 Hz from 1 to 400 Hz",
    )


def claim_bare(chawda: Chawda) -> Claim:
    """Error without a wall, friction and quantum."""
    must = fidelity_without_wall(*mass_and_damping(), BAND)
    found = {name: control["fidelity"] for name, control in chawda.controls.items()}
    return Claim(
        key="control-bare",
        claim="control: the fidelity error without a wall is √mean(b² + (2π·m·f)²)",
        paper="(theory)",
        finding=rules.controlled(found, must, "N·s/m"),
        needs="nothing",
        rule=f"within {100 * rules.SAME_CONTROL:g} %, lines of 1 Hz from 1 to 400 Hz",
    )
