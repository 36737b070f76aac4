"""Claims of Chawda et al. about K-widths and B-widths, counted over readings."""

from __future__ import annotations

import math

from rig.papers.chawda import rules
from rig.papers.chawda.readings import Readings
from rig.papers.chawda.results import Chawda, spread
from rig.papers.chawda.rigs import AKF, ESTIMATORS, FDM, FILTERS, FOAW, LEVANT
from rig.papers.frame import Claim, over, shown, verdict_over


def _stiffnesses(chawda: Chawda) -> list[dict[str, float]]:
    return [{name: width.stiffness for name, width in of.items()} for of in chawda.read]


def claim_order(chawda: Chawda) -> Claim:
    """All four K-widths in the paper's order."""
    widths = _stiffnesses(chawda)
    held = sum(rules.in_order([k[LEVANT], k[AKF], k[FDM], k[FOAW]]) for k in widths)
    return Claim(
        key="order",
        claim="K-widths come in the order Levant > AKF > FDM+filter > FOAW (Figs. 7 and 8, Table I)",
        paper="3.6, 2.7, 2.4, 2.1 × 10⁴ N/m",
        finding=rules.share_of(held, len(widths), "readings"),
        needs="something that is not in the rigid model",
        rule=f"in at least {100 * rules.MOST:.0f} % of the readings (bands, tolerances, measurements)",
    )


def claim_levant_stiffest(chawda: Chawda) -> Claim:
    """Levant's K-width against the others'."""
    widths = _stiffnesses(chawda)
    held = sum(k[LEVANT] > max(k[name] for name in FILTERS) for k in widths)
    lowest = sum(k[LEVANT] <= min(k[name] for name in FILTERS) for k in widths)
    best = max(range(len(chawda.variant_names)), key=lambda n: chawda.variants.width(0, 0, n).stiffness)
    other = chawda.variants.width(0, 0, best).stiffness
    said = (
        f"lowest or level with the lowest in {lowest}; of {len(chawda.variant_names)} other forms of it the best, "
        f"{chawda.variant_names[best]}, has {shown(other / 1e3)} kN/m by the main reading against "
        f"{shown(_mean_k(chawda, LEVANT))} with the printed gains and {shown(_mean_k(chawda, FDM))} of FDM+filter"
    )
    return Claim(
        key="levant-stiffest",
        claim="the stiffest walls are rendered with Levant's differentiator",
        paper="3.6 × 10⁴ N/m",
        finding=rules.share_of(held, len(widths), "readings", said),
        needs="as above; the printed gains are C = 6 m/s², a hit asks for "
        f"{shown(min(c['lipschitz'] for c in chawda.constants))} or more",
        rule=f"in at least {100 * rules.MOST:.0f} % of the readings",
    )


def _mean_k(chawda: Chawda, name: str) -> float:
    return spread(chawda.widths(name), "stiffness").mean / 1e3


def akf_ratios(chawda: Chawda) -> dict[str, list[float]]:
    """K of AKF over K of FDM+filter from 40 N·s/m to 400: linear theory and hits at 1 kHz."""
    linear = [
        over(a, f)
        for b, a, f in zip(
            chawda.linear_dampings, chawda.linear[AKF]["stable"], chawda.linear[FDM]["stable"], strict=True
        )
        if b >= rules.LEAST_DAMPING
    ]
    last = chawda.linear_dampings[-1]
    akf, fdm = (chawda.slow_hits.curve(ESTIMATORS.index(name), "felt") for name in (AKF, FDM))
    hits = [
        over(a.stiffness, f.stiffness)
        for a, f in zip(akf, fdm, strict=True)
        if rules.LEAST_DAMPING <= a.damping <= last
    ]
    return {"linear theory, stable": linear, "hits at 1 kHz": hits}


def claim_akf_over_fdm(chawda: Chawda) -> Claim:
    """AKF's against that of the filtered difference: theory, hits, excited."""
    widths = _stiffnesses(chawda)
    told = [k for k in widths if k[AKF] != k[FDM]]
    above = sum(k[AKF] > k[FDM] for k in told)
    share = above / len(told) if told else 0.0
    ratios = akf_ratios(chawda)
    steps = dict(zip(ratios, (1.0, chawda.scale.hit_ratio**0.5), strict=True))
    cases = {name: rules.mostly_stiffer(values, steps[name]) for name, values in ratios.items()}
    cases["excited"] = bool(told) and share >= rules.MOST
    ours = (
        "; ".join(f"{name} {rules.times_of(values)}" for name, values in ratios.items())
        + f" from B = {rules.LEAST_DAMPING:g} to {chawda.linear_dampings[-1]:g}; excited: stiffer in {above} of "
        f"{len(told)} readings that tell them apart ({len(widths) - len(told)} do not)"
    )
    return Claim(
        key="akf-over-fdm",
        claim="AKF has a larger K-width than FDM+filter",
        paper="2.7 against 2.4 × 10⁴ N/m",
        finding=verdict_over(cases, ours),
        needs="damping: it is the smaller delay of its velocity",
        rule=f"at none of these dampings softer, in the median at least {rules.STIFFER:g} times as stiff (rungs of the "
        "hits allowed for); excited: in at least "
        f"{100 * rules.MOST:.0f} % of the readings that tell them apart",
    )


def claim_fdm_over_foaw(chawda: Chawda) -> Claim:
    """The filtered difference's against FOAW's, with friction and without."""
    cases = {
        f"{name}, {text}": compared
        for name, found in (("friction", chawda.map), ("no friction", chawda.frictionless))
        for text, compared in _compared(found).items()
    }
    return Claim(
        key="fdm-over-foaw",
        claim="FDM+filter has a larger K-width than FOAW",
        paper="2.4 against 2.1 × 10⁴ N/m",
        finding=rules.mostly_larger(cases, "readings that tell them apart"),
        needs="little friction; a tolerance that grows with the noise forgives FOAW more than FDM+filter",
        rule=f"in at least {100 * rules.MOST:.0f} % of the readings that tell them apart, tolerance by tolerance",
    )


def _compared(found: Readings) -> dict[str, tuple[int, int]]:
    """By tolerance: how often the first of two schemes has the larger K-width, of how many readings that differ."""
    counts: dict[str, tuple[int, int]] = {}
    for number, reading in enumerate(found.grid.readings):
        text = reading.text.split(", ")[1]
        above, told = counts.get(text, (0, 0))
        for m in range(found.grid.measurements):
            first, second = (found.width(m, number, scheme).stiffness for scheme in (0, 1))
            above, told = above + (first > second), told + (first != second)
        counts[text] = above, told
    return counts


def claim_damping_width(chawda: Chawda) -> Claim:
    """B-widths."""
    held = [
        {name: -1.0 if math.isnan(width.damping) else width.damping for name, width in of.items()}
        for of in chawda.read
    ]
    said = [of for of in held if max(of.values()) >= 0.0]
    widest = sum(of[FDM] >= max(of.values()) for of in said)
    alone = sum(of[FDM] > max(value for name, value in of.items() if name != FDM) for of in said)
    return Claim(
        key="damping-width",
        claim="FDM+filter has the largest B-width",
        paper="160 against 100 to 120 N·s/m",
        finding=rules.share_of(alone, len(said), "readings", f"level with the widest in {widest}"),
        needs="an upper edge of the band that tells the filters apart",
        rule=f"alone the widest in at least {100 * rules.MOST:.0f} % of the readings that hold any wall",
    )
