"""Sections of the report on Chawda et al.: what each picture shows, in sentences made of the numbers beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rig.control.estimators import levant_regions
from rig.experiments.impedance import ImpedanceResult
from rig.experiments.zwidth import ZWidth
from rig.papers.chawda import text_maps as chawda_text_maps
from rig.papers.chawda import text_more as chawda_text_more
from rig.papers.chawda.claims_hits import curve, ranges
from rig.papers.chawda.parts import NOMINAL
from rig.papers.chawda.results import Chawda
from rig.papers.chawda.rigs import FILTERED, HBA_SC, LFBA, LOWPASS_HZ, PUSH, SCHEMES
from rig.papers.frame import Claim, Picture, Section, Status, Table, shown


def summary(chawda: Chawda, claims: Sequence[Claim]) -> tuple[str, ...]:
    """What stands first."""
    count = {status: sum(c.finding.status is status for c in claims) for status in Status}
    return (
        f"Of {len(claims)} claims {count[Status.REPRODUCED]} are reproduced, {count[Status.ONLY_WITH]} only under a "
        f"condition, {count[Status.NOT]} are not. Every verdict is computed from the numbers of this run by the rule "
        "beside it.",
        f"{chawda.runs} excited runs and {chawda.hits.hits + chawda.slow_hits.hits} wall hits, all simulated: the "
        "paper's rigid mass with viscous and Coulomb friction and a 1 µm encoder, nothing fitted. The paper does not "
        "say over which band, with which tolerance and from which record its passivity test was made; so each "
        f"measured wall is read in {len(chawda.map.grid.readings)} ways, and claims are counted over "
        f"{len(chawda.read)} readings.",
    )


def sections(chawda: Chawda) -> tuple[Section, ...]:
    """All sections in the order of the report."""
    return (
        _figure_1(),
        _figure_3(chawda),
        _slow_hits(chawda),
        _figure_4(chawda),
        chawda_text_maps.figure_5(chawda),
        _figure_6(chawda),
        chawda_text_maps.figure_7(chawda),
        chawda_text_maps.table_1(chawda),
        chawda_text_more.readings(chawda),
        chawda_text_more.theory(chawda),
        chawda_text_more.variants(chawda),
        chawda_text_more.dual(chawda),
    )


def _figure_1() -> Section:
    mu1, mu2 = levant_regions.crossing()
    needed = levant_regions.worst_case_mu2(1.1)
    return Section(
        key="figure-1",
        title="Fig. 1: gains with which Levant's differentiator converges",
        text=(
            f"The boundaries of the two proofs cross at μ1 = {mu1:.4f}, μ2 = {mu2:.4f}. HBA-SC (1.1, 1) lies in "
            f"neither region; computed over every disturbance, μ1 = 1.1 converges from μ2 = {needed:.3f} on, so that "
            "both proofs are far on the safe side and HBA-SC is at the very edge.",
        ),
        conditions=(
            "α = μ1·C, λ = μ2·√C; equations (10) and (14). The dashed boundary is computed, not proven.",
        ),
        pictures=(Picture("figure-1", "Shaded: proven to converge."),),
    )


def _limit(value: float, capped: int) -> str:
    return f"{'≥ ' if capped else ''}{shown(value / 1e3)}"


def _curves(
    found: ZWidth, names: Sequence[str], criterion: str, chosen: Sequence[str]
) -> list[tuple[str, ...]]:
    rows = []
    for name in chosen:
        boundaries = found.curve(list(names).index(name), criterion)
        rows.append((name, *(_limit(b.stiffness, b.capped) for b in boundaries)))
    return rows


def _figure_3(chawda: Chawda) -> Section:
    hits, names = chawda.hits, chawda.hit_names
    drops, most = ranges(chawda), chawda.scale.hit_dampings[-1]
    main = tuple(dict.fromkeys((FILTERED, HBA_SC, LFBA, chawda.adjusted)))
    said = ", ".join(
        f"{name} {'beyond ' + shown(most) if math.isinf(drops[name]) else shown(drops[name])}"
        for name in main
    )
    peaks = ", ".join(f"{name} {shown(max(curve(chawda, name)) / 1e3)}" for name in main)
    constants = "; ".join(
        f"K = {c['stiffness'] / 1e3:g} kN/m, B = {c['damping']:g}: {shown(c['lipschitz'])} m/s² "
        f"(true {shown(c['true'])})"
        for c in chawda.constants
    )
    columns = tuple(f"B = {b:g}" for b in chawda.scale.hit_dampings)
    return Section(
        key="figure-3",
        title="Fig. 3: Z-width in the time domain at 10 kHz",
        text=(
            f"Where each Z-width falls below half of its peak for good (N·s/m): {said}. "
            f"Stiffest walls (kN/m): {peaks}.",
            f"C by the paper's way (six sines on the counts from 20 ms before to 60 ms after the contact of a hit with "
            f"the filtered difference): {constants}. It depends on the wall: gains fixed at one wall are too small at "
            f"a stiffer one. Used here: {shown(chawda.lipschitz)} m/s² of the wall K = {NOMINAL[0] / 1e3:g} kN/m, "
            f"B = {NOMINAL[1]:g} N·s/m.",
            f"Adjusted gains: of {len(names) - 1} pairs that were tried on the rig (C from "
            f"{min(chawda.scale.constants):g} to {max(chawda.scale.constants):g} m/s², with the multipliers of HBA-SC "
            f"and of LFBA) the one with the largest area of its Z-width up to the search's end: {chawda.adjusted}.",
        ),
        conditions=(
            f"chawda-linear at 10 kHz, automated: {PUSH['trial.effort']:g} N from "
            f"{1e3 * abs(PUSH['trial.start']):g} mm before the wall, so that it still rests "
            f"{PUSH['trial.minimum_rest_counts']:g} counts deep at the highest stiffness; limits of effort and "
            "slew rate raised (they are declared, not the paper's) so that nothing saturates.",
            f"Ladder from 2 kN/m with rungs {100 * (chawda.scale.hit_ratio - 1):.2g} % apart, encoder offsets "
            f"{', '.join(map(str, chawda.scale.offsets))}; ≥: the push rests less than that deep in stiffer walls.",
            "A wall fails when the handle leaves it in the tail, when its ripple grows, or when it is felt: true "
            f"velocity above 2 mm/s rms from 30 Hz to {LOWPASS_HZ[10_000]:g} Hz. Heard (effort ripple above 1 N rms) "
            "is shown beside it.",
            "Levant: explicit Euler, output u, α = μ1·C, λ = μ2·√C; HBA-SC (1.1, 1), LFBA (4, 1.5). The paper prints "
            "neither its C at 10 kHz nor the gains of LFBA and adjusted.",
        ),
        pictures=(
            Picture("figure-3", "Largest stable stiffness over damping: left not felt, right not heard."),
            Picture("figure-3-gains", "The same for every pair of gains tried: where it drops is set by C."),
        ),
        tables=tuple(
            Table(f"K_max (kN/m), stable and not {criterion}", ("scheme", *columns), tuple(rows))
            for criterion, rows in (
                ("felt", _curves(hits, names, "felt", names)),
                ("heard", _curves(hits, names, "heard", main)),
            )
        ),
    )


def _slow_hits(chawda: Chawda) -> Section:
    hits = chawda.slow_hits
    columns = tuple(f"B = {b:g}" for b in chawda.scale.hit_dampings)
    peaks = ", ".join(
        f"{name} {shown(hits.width(number, 'felt').stiffness_peak / 1e3)}"
        for number, name in enumerate(SCHEMES)
    )
    return Section(
        key="hits",
        title="The four estimators hit at 1 kHz",
        text=(f"Stiffest walls (kN/m): {peaks}. The same estimators as in Fig. 7, judged as in Fig. 3.",),
        conditions=(
            f"As Fig. 3, at 1 kHz, felt from 30 Hz to {LOWPASS_HZ[1000]:g} Hz, rungs "
            f"{100 * (chawda.scale.hit_ratio**0.5 - 1):.2g} % apart; dashed: exact linear theory without friction "
            "and quantum.",
        ),
        pictures=(Picture("hits", "Largest stable stiffness over damping at 1 kHz."),),
        tables=(
            Table(
                "K_max (kN/m), stable and not felt",
                ("estimator", *columns),
                tuple(_curves(hits, list(SCHEMES), "felt", list(SCHEMES))),
            ),
        ),
    )


def _verdict(result: ImpedanceResult) -> str:
    if result.judgement is None:
        return f"no impedance: {result.ended}"
    return "passive" if result.judgement.passive else f"not passive ({'; '.join(result.judgement.reasons)})"


def _figure_4(chawda: Chawda) -> Section:
    bare, walled = chawda.impedances[:2]
    fitted = bare.fitted
    text = []
    if fitted is not None:
        mass, damping = fitted.values["inertia"], fitted.values["damping"]
        text.append(
            f"The bare rig reads a mass of {shown(mass)} kg and a damping of {shown(damping)} N·s/m: Coulomb friction "
            "adds to the 13.2 N·s/m that it has."
        )
    text.append(f"With the wall: {_verdict(walled)}.")
    return Section(
        key="figure-4",
        title="Fig. 4: impedance of the bare rig and of a wall",
        text=tuple(text),
        conditions=(_excitation(chawda), f"Wall: {walled.label}; judged from 1 to 400 Hz."),
        pictures=(Picture("figure-4", "Magnitude, phase, real part; dashed: the ideal wall."),),
    )


def _excitation(chawda: Chawda) -> str:
    x = chawda.map.grid.experiment.excitation
    return (
        f"Random-phase multisine of a second actuator, {x.low_hz:g} to {x.high_hz:g} Hz every {1 / x.period_s:g} Hz, "
        f"{x.rms:g} N rms, {x.settle_periods} periods to settle and {x.periods} analysed, "
        f"{chawda.scale.realisations} realisations for one measurement; positions from encoder counts at 4 kHz."
    )


def _figure_6(chawda: Chawda) -> Section:
    rows = []
    for name, result in zip(SCHEMES, chawda.impedances[1:], strict=True):
        fidelity = result.fidelity
        cells = ("–",) * 3
        if fidelity is not None:
            cells = (shown(fidelity.rms), shown(fidelity.stiffness_percent), shown(fidelity.damping_percent))
        rows.append((name, *cells, _verdict(result)))
    return Section(
        key="figure-6",
        title="Fig. 6: measured against ideal magnitude",
        text=(
            "At low frequencies the wall's stiffness shows, at high ones the rig's mass, and the difference from the "
            "ideal wall there is what the fidelity error measures. Stiffness and damping as fitted say more about the "
            "estimator.",
        ),
        conditions=(
            _excitation(chawda),
            f"Wall: K = {chawda.impedances[1].wall[0]:g} N/m, B = {chawda.impedances[1].wall[1]:g} N·s/m.",
        ),
        pictures=(Picture("figure-6", "Magnitude under the four estimators, and its error."),),
        tables=(
            Table(
                "fidelity from 1 to 400 Hz",
                ("estimator", "rms error (N·s/m)", "K fitted (%)", "B fitted (%)", "verdict"),
                tuple(rows),
            ),
        ),
    )
