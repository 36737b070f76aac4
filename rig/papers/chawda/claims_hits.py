"""Claims of Chawda et al. about gains and wall hits: Figs. 1 and 3."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rig.control.estimators import levant_regions
from rig.experiments.table_one import FrequencyWidth
from rig.papers.chawda import rules
from rig.papers.chawda.results import Chawda
from rig.papers.chawda.rigs import ESTIMATORS, FDM, FILTERED, HBA_SC, LEVANT, LFBA
from rig.papers.frame import Claim, over, shown, times, verdict_over


def claim_regions() -> Claim:
    """Fig. 1: which gains lie where."""
    mu1, mu2 = levant_regions.NAMED_GAINS["hba-sc"]
    outside = not (levant_regions.in_hba(mu1, mu2) or levant_regions.in_lfba(mu1, mu2))
    extends = levant_regions.in_lfba(4.0, 1.5) and not levant_regions.in_hba(4.0, 1.5)
    misses = levant_regions.in_hba(2.0, 4.0) and not levant_regions.in_lfba(2.0, 4.0)
    cross = levant_regions.crossing()
    ours = (
        f"boundaries cross at μ1 = {cross[0]:.4f}, μ2 = {cross[1]:.4f}; HBA-SC ({mu1:g}, {mu2:g}) "
        f"{'in neither' if outside else 'inside'}"
    )
    return Claim(
        key="regions",
        claim="LFBA adds gains that HBA does not have, without containing it; HBA-SC lies outside both (Fig. 1)",
        paper="a picture",
        finding=verdict_over({"": outside and extends and misses}, ours),
        needs="nothing",
        rule="equations (10) and (14) at HBA-SC, at (4, 1.5) and at (2, 4)",
    )


def curve(chawda: Chawda, name: str) -> list[float]:
    """Mean limits of one scheme of Fig. 3 over the dampings."""
    return [b.stiffness for b in chawda.hits.curve(chawda.hit_names.index(name), "felt")]


def _ratios(chawda: Chawda, name: str, up_to: float = math.inf) -> list[float]:
    """K over that of the filtered difference at each damping above 0, where not both are only caps."""
    of, filtered = (chawda.hits.curve(chawda.hit_names.index(one), "felt") for one in (name, FILTERED))
    return [
        over(a.stiffness, b.stiffness)
        for a, b in zip(of, filtered, strict=True)
        if 0.0 < a.damping <= up_to and not (a.capped and b.capped)
    ]


def _unknown(chawda: Chawda, names: Sequence[str], up_to: float = math.inf) -> str:
    """At how many dampings nothing can be said."""
    dampings = sum(0.0 < b <= up_to for b in chawda.scale.hit_dampings)
    top = max(chawda.hits.plan.search.rungs) / 1e3
    beyond = {name: dampings - len(_ratios(chawda, name, up_to)) for name in names}
    said = ", ".join(f"{name} at {count}" for name, count in beyond.items() if count)
    return (
        f"; of {dampings} dampings both are stiffer than the search ({shown(top)} kN/m): {said}"
        if said
        else ""
    )


def claim_stiffer_levant(chawda: Chawda) -> Claim:
    """Adjusted gains, and any others that were tried, against the filtered difference."""
    best = {name: max(_ratios(chawda, name), default=0.0) for name in chawda.hit_names if name != FILTERED}
    winner = max(best, key=lambda name: best[name])
    ratios = _ratios(chawda, chawda.adjusted)
    ours = (
        f"{chawda.adjusted}: {rules.times_of(ratios) if ratios else 'unknown'} of the filtered difference"
        f"{_unknown(chawda, [chawda.adjusted])}; best of all gains tried × {shown(best[winner])} ({winner})"
    )
    return Claim(
        key="levant-stiffer",
        claim="Levant with adjusted gains renders stiffer walls than FDM with a 1 kHz filter (Fig. 3)",
        paper="stiffer, at low damping",
        finding=verdict_over({"": best[winner] >= rules.STIFFER * chawda.scale.hit_ratio}, ours),
        needs="unknown: in simulation the filtered difference at 10 kHz is limited by little but the push",
        rule=f"with some gains that were tried, at some B > 0, K at least {rules.STIFFER:g} times, and a rung of the "
        "search, above the filtered difference; where both exceed the search nothing is counted",
    )


def claim_stiffer_below(chawda: Chawda) -> Claim:
    """Gains of HBA and LFBA against the filtered difference."""
    cases = {name: _ratios(chawda, name, rules.BETTER_UP_TO) for name in (HBA_SC, LFBA)}
    known = {name: ratios for name, ratios in cases.items() if ratios}
    found = rules.stiffer(known, chawda.scale.hit_ratio)
    unknown = _unknown(chawda, list(cases), rules.BETTER_UP_TO)
    return Claim(
        key="levant-stiffer-below",
        claim="with HBA and LFBA gains too, up to B = 150 (Fig. 3)",
        paper="better up to 150 N·s/m",
        finding=replace(found, ours=found.ours + unknown),
        needs="as above",
        rule=f"over 0 < B ≤ {rules.BETTER_UP_TO:g} nowhere softer by more than a rung, in the median at least "
        f"{rules.STIFFER:g} times, and half a rung, stiffer; where both exceed the search nothing is counted",
    )


def ranges(chawda: Chawda) -> dict[str, float]:
    """Where each Z-width of Fig. 3 drops below half of its peak for good; infinite where it does not."""
    dampings = chawda.scale.hit_dampings
    return {name: rules.dropped(dampings, curve(chawda, name)) for name in chawda.hit_names}


def claim_filter_holds(chawda: Chawda) -> Claim:
    """Damping that the filtered difference holds."""
    held = ranges(chawda)[FILTERED]
    most = chawda.scale.hit_dampings[-1]
    return Claim(
        key="filter-holds",
        claim="FDM with the filter holds walls of more damping (Fig. 3)",
        paper="beyond 350 N·s/m",
        finding=verdict_over(
            {"": held > rules.FILTER_HOLDS},
            f"drops {'beyond ' + shown(most) if math.isinf(held) else f'at {shown(held)}'} N·s/m",
        ),
        needs="nothing",
        rule=f"K stays above half of its peak beyond {rules.FILTER_HOLDS:g} N·s/m",
    )


def claim_limited(chawda: Chawda) -> Claim:
    """Damping that Levant's differentiator holds."""
    main = {name: _range(chawda.widths(name)) for name in (FDM, LEVANT)}
    slow = {
        name: chawda.slow_hits.width(ESTIMATORS.index(name), "felt").damping_range for name in (FDM, LEVANT)
    }
    found = rules.limited({"excited": main[LEVANT], "hit at 1 kHz": slow[LEVANT]}, min(main[FDM], slow[FDM]))
    return Claim(
        key="levant-limited",
        claim="Levant is limited in damping (Table I, Figs. 3 and 7)",
        paper="B-width 100 against 160 of FDM+filter",
        finding=found,
        needs="nothing: explicit Euler chatters by 1.17·α·T at rest, and damping turns that into force",
        rule=f"range of B at most {rules.LIMITED:g} of that of FDM+filter, by the main reading and hit at 1 kHz",
    )


def _range(widths: Sequence[FrequencyWidth]) -> float:
    values = [width.damping for width in widths if math.isfinite(width.damping)]
    return float(np.mean(values)) if values else 0.0


def claim_sharp(chawda: Chawda) -> Claim:
    """How sharply the Z-widths end."""
    falls = {name: rules.sharpness(curve(chawda, name)) for name in (HBA_SC, LFBA, chawda.adjusted)}
    filtered = rules.sharpness(curve(chawda, FILTERED))
    ours = "; ".join(f"{name} {times(fall)}" for name, fall in falls.items())
    cases = {name: fall >= rules.SHARP and fall > filtered for name, fall in falls.items()}
    return Claim(
        key="sharp-drop",
        claim="with Levant the Z-width ends in a sharp drop at some damping, with FDM+filter it does not (Fig. 3)",
        paper="a sharp drop",
        finding=verdict_over(cases, f"{ours}; {FILTERED} {times(filtered)} from one damping to the next"),
        needs="nothing; what happens above the stiffest wall of the search is not seen",
        rule=f"K falls at least {rules.SHARP:g} times from one damping to the next, and more than with FDM+filter",
    )


def claim_where_it_drops(chawda: Chawda) -> Claim:
    """Where they end."""
    found = ranges(chawda)
    drops = {
        HBA_SC: (found[HBA_SC], rules.DROP),
        LFBA: (found[LFBA], rules.DROP),
        chawda.adjusted: (found[chawda.adjusted], rules.DROP_ADJUSTED),
    }
    others = [value for name, value in found.items() if name != FILTERED]
    return Claim(
        key="where-it-drops",
        claim="where it drops (Fig. 3)",
        paper="about 250 N·s/m (HBA, LFBA), about 300 (adjusted)",
        finding=rules.drops_at(drops, others, chawda.scale.hit_dampings[-1]),
        needs="the gains, which the paper does not print: they set it",
        rule=f"within {100 * (rules.NEAR_DROP - 1):.0f} % of the paper's",
    )
