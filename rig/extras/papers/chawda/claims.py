"""Judge the claims of Chawda et al.: pass the computed numbers to the rule of each claim (`rules` in this folder).

`reproduction` uses it. Thresholds are in `rules`, sentences in ``claims.j2``.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from rig.analysis.impedance import ideal_wall
from rig.control.estimators import levant_regions
from rig.extras.papers.chawda import derived, rigs, rules
from rig.extras.papers.chawda.parts import fidelity_without_wall
from rig.extras.papers.chawda.results import Chawda, spread
from rig.extras.papers.rules import MOST, Ruling, each, judge, judge_share, over


def rulings(chawda: Chawda) -> dict[str, Ruling]:
    """Judge every claim of the paper; return the ruling (verdict and its numbers) by the claim's key."""
    drops = derived.drops(chawda)
    fits = [fit for of in derived.by_edge(chawda).values() for fit in of]
    mass, damping = derived.mass_and_damping()
    controls = {
        what: {name: control[what] for name, control in chawda.controls.items()}
        for what in ("stiffness", "fidelity")
    }
    return {
        "regions": _regions(),
        "levant-stiffer": _stiffer_levant(chawda),
        "levant-stiffer-below": _stiffer_below(chawda),
        "filter-holds": judge({"": drops[rigs.FILTERED] > rules.FILTER_HOLDS}, drop=drops[rigs.FILTERED]),
        "levant-limited": _rule_limit(chawda),
        "sharp-drop": _sharp(chawda),
        "where-it-drops": rules.drops_at(
            {
                rigs.HBA_SC: (drops[rigs.HBA_SC], rules.DROP),
                rigs.LFBA: (drops[rigs.LFBA], rules.DROP),
                chawda.adjusted: (drops[chawda.adjusted], rules.DROP_ADJUSTED),
            },
            [value for name, value in drops.items() if name != rigs.FILTERED],
        ),
        "order": _order(chawda),
        "levant-stiffest": _levant_stiffest(chawda),
        "akf-over-fdm": _akf_over_fdm(chawda),
        "fdm-over-foaw": rules.mostly_larger(
            {
                f"{name}, {allowed}": count
                for name, found in (("friction", chawda.map), ("no friction", chawda.frictionless))
                for allowed, count in derived.larger_first(found).items()
            }
        ),
        "damping-width": _damping_width(chawda),
        "lowest-error": _lowest_error(chawda),
        "error-order": _error_order(chawda),
        "best-gains": _best_gains(chawda),
        "combined": rules.combined(*(chawda.combined.width(0, 0, number) for number in range(3))),
        "damping-widths": _damping_widths(chawda),
        "attenuated": _attenuated(chawda),
        "common-error": rules.lower(
            {
                (name, high): gains
                for high, of in derived.common_gains_by_edge(chawda).items()
                for name, gains in of.items()
            }
        ),
        "error-grows": _error_grows(chawda),
        "widths": judge_share(
            sum(widths for widths, _ in fits),
            len(fits),
            closed=list(
                zip(
                    rigs.HIGHEST_HZ,
                    *(derived.closed_widths(chawda, name) for name in (rigs.FDM, rigs.AKF)),
                    strict=True,
                )
            ),
        ),
        "errors": judge_share(
            sum(errors for _, errors in fits),
            len(fits),
            floors=list(derived.floors().items()),
            edges=[
                (name, rigs.PRINTED[name].worst_fidelity, derived.edge_of(rigs.PRINTED[name].worst_fidelity))
                for name in (rigs.FOAW, rigs.FDM)
            ],
        ),
        "both": _both(chawda),
        "wider": rules.wider(
            {
                name: over(spread(chawda.widths(name), "stiffness").mean, rigs.PRINTED[name].stiffness)
                for name in rigs.ESTIMATORS
            },
            chawda.scale.rung,
        ),
        "search": _search(chawda),
        "control-undamped": rules.controlled(controls["stiffness"], 2.0 * damping * rigs.RENDERING_HZ),
        "control-bare": rules.controlled(
            controls["fidelity"], fidelity_without_wall(mass, damping, rigs.CONTROL_BAND)
        ),
    }


def _regions() -> Ruling:
    gains = levant_regions.NAMED_GAINS["hba-sc"]
    inside = levant_regions.in_hba(*gains) or levant_regions.in_lfba(*gains)
    extra, missed = rigs.GAINS[rigs.LFBA], (2.0, 4.0)
    extends = levant_regions.in_lfba(*extra) and not levant_regions.in_hba(*extra)
    misses = levant_regions.in_hba(*missed) and not levant_regions.in_lfba(*missed)
    return judge(
        {"": not inside and extends and misses},
        crossing=levant_regions.find_crossing(),
        gains=gains,
        inside=inside,
        points=[[*extra], [*missed]],
    )


def _beyond(chawda: Chawda, names: Sequence[str], up_to: float = math.inf) -> dict[str, Any]:
    """Count the dampings at which the stiffness limits of sampling schemes `names` lie beyond the searched stiffnesses.

    ``dampings`` is the number of dampings in (0, `up_to`] N·s/m, ``top`` the stiffest searched wall (N/m). ``beyond``
    has (scheme, number of dampings at which its limit and that of the filtered difference both exceed ``top``).
    """
    dampings = sum(0.0 < b <= up_to for b in chawda.scale.hit_dampings)
    beyond = [(name, dampings - len(derived.over_filtered(chawda, name, up_to))) for name in names]
    return {
        "dampings": dampings,
        "top": max(chawda.hits.plan.search.rungs),
        "beyond": [(name, count) for name, count in beyond if count],
    }


def _stiffer_levant(chawda: Chawda) -> Ruling:
    best = {
        name: max(derived.over_filtered(chawda, name), default=0.0)
        for name in chawda.hit_names
        if name != rigs.FILTERED
    }
    winner = max(best, key=lambda name: best[name])
    ratios = derived.over_filtered(chawda, chawda.adjusted)
    known = {chawda.adjusted: ratios} if ratios else {}
    return rules.stiffer(known, chawda.scale.hit_ratio).having(
        adjusted=chawda.adjusted,
        ratios=ratios,
        winner=winner,
        best=best[winner],
        **_beyond(chawda, [chawda.adjusted]),
    )


def _stiffer_below(chawda: Chawda) -> Ruling:
    names = (rigs.HBA_SC, rigs.LFBA)
    cases = {name: derived.over_filtered(chawda, name, rules.BETTER_UP_TO) for name in names}
    known = {name: ratios for name, ratios in cases.items() if ratios}
    found = rules.stiffer(known, chawda.scale.hit_ratio)
    return found.having(**_beyond(chawda, names, rules.BETTER_UP_TO))


def _rule_limit(chawda: Chawda) -> Ruling:
    excited, hit = {}, {}
    for name in (rigs.FDM, rigs.LEVANT):
        values = [width.damping for width in chawda.widths(name) if math.isfinite(width.damping)]
        excited[name] = float(np.mean(values)) if values else 0.0
        hit[name] = chawda.slow_hits.width(rigs.ESTIMATORS.index(name), "felt").damping_range
    return rules.limited(
        {"with excitation": excited[rigs.LEVANT], "by hits at 1 kHz": hit[rigs.LEVANT]},
        min(excited[rigs.FDM], hit[rigs.FDM]),
        rigs.PRINTED[rigs.FDM].damping / rigs.PRINTED[rigs.LEVANT].damping,
    )


def _sharp(chawda: Chawda) -> Ruling:
    names = (rigs.HBA_SC, rigs.LFBA, chawda.adjusted)
    falls = {name: rules.sharpness(derived.curve(chawda, name)) for name in names}
    filtered = rules.sharpness(derived.curve(chawda, rigs.FILTERED))
    cases = {name: fall >= rules.SHARP and fall > filtered for name, fall in falls.items()}
    return judge(cases, conditions=each(cases), falls=list(falls.items()), filtered=filtered)


def _stiffnesses(chawda: Chawda) -> list[dict[str, float]]:
    return [{name: width.stiffness for name, width in of.items()} for of in chawda.read]


def _order(chawda: Chawda) -> Ruling:
    widths = _stiffnesses(chawda)
    count = sum(rules.is_in_order([k[rigs.LEVANT], k[rigs.AKF], k[rigs.FDM], k[rigs.FOAW]]) for k in widths)
    return judge_share(count, len(widths))


def _levant_stiffest(chawda: Chawda) -> Ruling:
    widths, variants = _stiffnesses(chawda), derived.variant_widths(chawda)
    best = max(variants, key=lambda name: variants[name].stiffness)
    return judge_share(
        sum(k[rigs.LEVANT] > max(k[name] for name in rigs.FILTERS) for k in widths),
        len(widths),
        lowest=sum(k[rigs.LEVANT] <= min(k[name] for name in rigs.FILTERS) for k in widths),
        variants=len(variants),
        best=best,
        stiffness=variants[best].stiffness,
        levant=spread(chawda.widths(rigs.LEVANT), "stiffness").mean,
        fdm=spread(chawda.widths(rigs.FDM), "stiffness").mean,
        constant=min(identified["lipschitz"] for identified in chawda.constants),
    )


def _akf_over_fdm(chawda: Chawda) -> Ruling:
    widths = _stiffnesses(chawda)
    differ = [k for k in widths if k[rigs.AKF] != k[rigs.FDM]]
    above = sum(k[rigs.AKF] > k[rigs.FDM] for k in differ)
    return judge(
        {"with excitation": bool(differ) and above >= MOST * len(differ)},
        ratios=list(derived.akf_over_fdm(chawda).items()),
        highest=chawda.linear_dampings[-1],
        above=above,
        differ=len(differ),
        total=len(widths),
    )


def _damping_width(chawda: Chawda) -> Ruling:
    every = [
        {name: float(np.nan_to_num(width.damping, nan=-1.0)) for name, width in of.items()}
        for of in chawda.read
    ]
    some = [of for of in every if max(of.values()) >= 0.0]
    return judge_share(
        sum(of[rigs.FDM] > max(value for name, value in of.items() if name != rigs.FDM) for of in some),
        len(some),
        widest=sum(of[rigs.FDM] >= max(of.values()) for of in some),
    )


def _lowest_error(chawda: Chawda) -> Ruling:
    errors = [{name: width.worst_fidelity for name, width in of.items()} for of in chawda.read]
    some = [of for of in errors if all(math.isfinite(of[name]) for name in rigs.FILTERS)]
    return judge_share(sum(of[rigs.FOAW] < min(of[rigs.FDM], of[rigs.AKF]) for of in some), len(some))


def _error_order(chawda: Chawda) -> Ruling:
    errors = [{name: width.worst_fidelity for name, width in of.items()} for of in chawda.read]
    some = [of for of in errors if all(math.isfinite(value) for value in of.values())]
    names = (rigs.FDM, rigs.LEVANT, rigs.AKF, rigs.FOAW)
    return judge_share(
        sum(rules.is_in_order([of[name] for name in names]) for of in some),
        len(some),
        highest=sum(of[rigs.FDM] > max(of[name] for name in names[1:]) for of in some),
        second=sum(sorted(of, key=lambda name: -of[name])[1] == rigs.LEVANT for of in some),
    )


def _best_gains(chawda: Chawda) -> Ruling:
    variants = {name: width.stiffness for name, width in derived.variant_widths(chawda).items()}
    own = spread(chawda.widths(rigs.LEVANT), "stiffness").mean
    best = max(variants, key=lambda name: variants[name])
    return rules.unsurpassed(own, variants, chawda.scale.rung).having(best=best, stiffness=variants[best])


def _damping_widths(chawda: Chawda) -> Ruling:
    paper = {name: rigs.PRINTED[name].damping for name in rigs.ESTIMATORS}
    each_ = [{name: float(np.nan_to_num(of[name].damping)) for name in paper} for of in chawda.read]
    found = {name: spread(chawda.widths(name), "damping").mean for name in paper}
    return judge_share(
        sum(rules.near_table(of, paper) for of in each_),
        len(each_),
        found=[(n, found[n], paper[n]) for n in paper],
    )


def _attenuated(chawda: Chawda) -> Ruling:
    shares = {}
    for name, result in zip(rigs.SCHEMES, chawda.impedances[1:], strict=True):
        if result.impedance is not None:
            part = result.impedance.within((0.0, rules.LOW_HZ))
            shares[name] = float(np.mean(part.magnitude / np.abs(ideal_wall(*result.wall, part.lines_hz))))
    return judge({n: rules.ATTENUATED <= s < 1.0 for n, s in shares.items()}, shares=list(shares.items()))


def _error_grows(chawda: Chawda) -> Ruling:
    found = derived.errors_of_quarters(chawda)
    return judge(
        {name: stiff >= rules.STIFFER * soft for name, (soft, stiff) in found.items()},
        errors=[(name, *of) for name, of in found.items()],
    )


def _both(chawda: Chawda) -> Ruling:
    foaw = rigs.PRINTED[rigs.FOAW].worst_fidelity
    closed = zip(
        rigs.HIGHEST_HZ, *(derived.closed_widths(chawda, name) for name in (rigs.FDM, rigs.AKF)), strict=True
    )
    largest = max(printed.stiffness for printed in rigs.PRINTED.values())
    cases = {
        f"a band up to {high:g} Hz": any(widths and errors for widths, errors in of)
        for high, of in derived.by_edge(chawda).items()
    }
    return judge(
        cases,
        conditions=each(cases),
        foaw=foaw,
        edge=derived.edge_of(foaw),
        largest=largest,
        needed=next((high for high, *widths in closed if min(widths) <= largest), math.inf),
    )


def _search(chawda: Chawda) -> Ruling:
    searches = [
        chawda.search(name, m) for name in rigs.ESTIMATORS for m in range(chawda.map.grid.measurements)
    ]
    return rules.traced(
        sum(search.above for search in searches),
        sum(search.below for search in searches),
        sum(search.unseen for search in searches),
        len(searches) * len(chawda.map.grid.dampings),
        tests=float(np.mean([len(search.path) for search in searches])),
        cells=searches[0].cells,
    )
