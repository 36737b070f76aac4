"""Claims of Chawda et al. about fidelity: whose error is smallest, and where."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rig.papers.chawda import rules
from rig.papers.chawda.results import Chawda
from rig.papers.chawda.rigs import AKF, ESTIMATORS, FDM, FILTERS, FOAW, HIGHEST_HZ, MAIN, READINGS
from rig.papers.frame import Claim, shown, verdict_over


def claim_lowest_error(chawda: Chawda) -> Claim:
    """Largest errors over the connected regions."""
    errors = [{name: width.worst_fidelity for name, width in of.items()} for of in chawda.read]
    said = [of for of in errors if all(math.isfinite(of[name]) for name in FILTERS)]
    lowest = sum(of[FOAW] < min(of[FDM], of[AKF]) for of in said)
    return Claim(
        key="lowest-error",
        claim="FOAW has the smallest maximum fidelity error",
        paper="294 against 520 to 895 N·s/m",
        finding=rules.share_of(lowest, len(said), f"readings that hold walls of {', '.join(FILTERS)}"),
        needs="luck: the largest error stands at the softest wall and belongs to the rig's inertia",
        rule=f"smaller than those of FDM+filter and AKF in at least {100 * rules.MOST:.0f} % of the readings",
    )


def common_gains(chawda: Chawda, reading: int = MAIN) -> dict[str, list[float]]:
    """Share of the mean error that FOAW saves at the walls that three estimators hold, by measurement."""
    numbers = {name: ESTIMATORS.index(name) for name in FILTERS}
    common = chawda.map.common(reading, list(numbers.values()))
    if not common.any():
        return {}
    mean = {
        name: [float(np.mean(of[common])) for of in chawda.map.fidelity[:, reading, number]]
        for name, number in numbers.items()
    }
    return {
        name: [1.0 - foaw / other for foaw, other in zip(mean[FOAW], mean[name], strict=True)]
        for name in (FDM, AKF)
    }


def claim_common_error(chawda: Chawda) -> Claim:
    """Errors at walls that three estimators hold, by upper edge of the band."""
    main = READINGS[MAIN]
    gains = {
        f"against {name} up to {high:g} Hz": values
        for high in HIGHEST_HZ
        for name, values in common_gains(chawda, READINGS.index(replace(main, high_hz=high))).items()
    }
    return Claim(
        key="common-error",
        claim="FOAW renders with the highest fidelity, at walls that all hold",
        paper="(not compared at the same walls)",
        finding=rules.lower(gains),
        needs="nothing known",
        rule=f"at least {100 * rules.BETTER_COMMON:g} % less mean error in every measurement, two standard deviations",
    )


def slopes(chawda: Chawda) -> dict[str, tuple[float, float]]:
    """Mean fidelity error of the connected region in its softest and its stiffest quarter of walls."""
    found = {}
    for number, name in enumerate(ESTIMATORS):
        held = chawda.map.common(MAIN, [number])
        errors = np.mean(chawda.map.fidelity[:, MAIN, number], axis=0)
        if held.sum() < 4:
            continue
        b, k = np.nonzero(held)
        stiffness = np.array(chawda.map.grid.stiffnesses)[k]
        low, high = np.percentile(stiffness, (25.0, 75.0))
        found[name] = (
            float(errors[b, k][stiffness <= low].mean()),
            float(errors[b, k][stiffness >= high].mean()),
        )
    return found


def claim_error_grows(chawda: Chawda) -> Claim:
    """Errors of soft and of stiff walls."""
    found = slopes(chawda)
    ours = "; ".join(f"{name} {shown(soft)} → {shown(stiff)} N·s/m" for name, (soft, stiff) in found.items())
    return Claim(
        key="error-grows",
        claim="fidelity is better at low K and B and deteriorates at high K (Fig. 7)",
        paper="for all methods",
        finding=verdict_over(
            {name: stiff >= rules.STIFFER * soft for name, (soft, stiff) in found.items()}, ours
        ),
        needs="saturation, which the paper suspects, or modes; the rigid rig's inertia has it the other way round",
        rule="mean error of the stiffest quarter of the walls that hold at least 5 % above that of the softest",
    )
