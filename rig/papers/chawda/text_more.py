"""Sections of the report on Chawda et al. beyond its figures: readings, theory, other forms of Levant, dual-rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig.config.schemes import Scheme
from rig.experiments.searches import connected
from rig.experiments.table_one import Spread
from rig.papers.chawda import rules
from rig.papers.chawda.claims_table import by_edge, closed_widths, floors
from rig.papers.chawda.readings import Readings
from rig.papers.chawda.results import Chawda, spread
from rig.papers.chawda.rigs import (
    AKF,
    DUAL_READINGS,
    FDM,
    HIGHEST_HZ,
    KOUL,
    LOWEST_HZ,
    NAMES,
    PAPERS_DUAL,
    PRINTED,
    READINGS,
    SCHEMES,
    TOLERANCES,
    Reading,
)
from rig.papers.chawda.text_maps import grid_of, of_spread
from rig.papers.frame import Picture, Section, Table, over, shown


def readings(chawda: Chawda) -> Section:
    """What band and tolerance decide."""
    rows = []
    for high in HIGHEST_HZ:
        for tolerance, kind in TOLERANCES:
            reading = Reading(low_hz=LOWEST_HZ[0], high_hz=high, tolerance=tolerance, kind=kind)
            number = READINGS.index(reading)
            widths = {name: chawda.widths(name, number) for name in SCHEMES}
            rows.append(
                (
                    reading.text,
                    *(of_spread(spread(of, "stiffness"), 1e3) for of in widths.values()),
                    *(of_spread(spread(of, "worst_fidelity")) for of in widths.values()),
                )
            )
    edges = []
    least = floors()
    for number, (high, fits) in enumerate(by_edge(chawda).items()):
        edges.append(
            (
                f"{high:g}",
                *(shown(closed_widths(chawda, name)[number] / 1e3) for name in (FDM, AKF)),
                shown(least[high]),
                f"{sum(widths for widths, _ in fits)} of {len(fits)}",
                f"{sum(errors for _, errors in fits)} of {len(fits)}",
                f"{sum(widths and errors for widths, errors in fits)} of {len(fits)}",
            )
        )
    lowest, highest = (closed_widths(chawda, FDM)[i] / 1e3 for i in (-1, 0))
    return Section(
        key="readings",
        title="What the band and the tolerance decide",
        text=(
            f"Without friction and quantum FDM+filter has a K-width of {shown(highest)} kN/m when lines up to "
            f"{HIGHEST_HZ[0]:g} Hz count and of {shown(lowest)} kN/m up to {HIGHEST_HZ[-1]:g} Hz: the velocity's delay "
            "turns damping against passivity above a quarter of the rate. The fidelity error grows with the same edge, "
            "because the rig's mass does.",
            "No reading of the same maps has all K-widths and all errors within a factor "
            f"{rules.NEAR_WIDTH:g} of Table I."
            if not any(w and e for fits in by_edge(chawda).values() for w, e in fits)
            else "Some readings have all K-widths and all errors near Table I.",
        ),
        conditions=(
            grid_of(chawda),
            f"Readings: lowest line {', '.join(f'{f:g}' for f in LOWEST_HZ)} Hz; tolerances as in the table. "
            "Friction's distortion is the same in every period, so that standard deviations are those between "
            "realisations.",
            "The excitation holds lines up to 400 Hz whatever counts.",
        ),
        pictures=(
            Picture("readings", "K-widths and largest errors over the band's upper edge, by tolerance."),
        ),
        tables=(
            Table(
                "by upper edge of the band (Hz): closed-form K-widths (kN/m), error without a wall (N·s/m), readings "
                f"within a factor {rules.NEAR_WIDTH:g} of Table I",
                ("up to", FDM, AKF, "no wall", "K-widths", "errors", "both"),
                tuple(edges),
            ),
            Table(
                "K-width (kN/m) and largest error (N·s/m) by reading, lowest line 1 Hz; Table I: "
                + ", ".join(
                    f"{name} {p.stiffness / 1e3:g} and {p.worst_fidelity:g}" for name, p in PRINTED.items()
                ),
                ("reading", *(f"{name}, K" for name in SCHEMES), *(f"{name}, error" for name in SCHEMES)),
                tuple(rows),
            ),
        ),
    )


def theory(chawda: Chawda) -> Section:
    """Linear limits."""
    rows = []
    for name in (FDM, AKF):
        of = chawda.linear[name]
        rows.append((f"{name}, stable", *(shown(k / 1e3) for k in of["stable"])))
        for high, passive in zip(HIGHEST_HZ, of["passive"], strict=True):
            rows.append((f"{name}, passive up to {high:g} Hz", *(shown(k / 1e3) for k in passive)))
    chosen = range(0, len(chawda.linear_dampings), max(1, len(chawda.linear_dampings) // 10))
    table = tuple((row[0], *(row[1 + i] for i in chosen)) for row in rows)
    ratios = [
        over(a, f)
        for b, a, f in zip(
            chawda.linear_dampings, chawda.linear[AKF]["stable"], chawda.linear[FDM]["stable"], strict=True
        )
        if b >= rules.LEAST_DAMPING
    ]
    ends = {name: chawda.linear[name]["range"] for name in (FDM, AKF)}
    return Section(
        key="theory",
        title="Closed forms",
        text=(
            f"AKF holds {shown(min(ratios))} to {shown(max(ratios))} times the stiffness of FDM+filter from B = "
            f"{rules.LEAST_DAMPING:g} to {chawda.linear_dampings[-1]:g} N·s/m, because it predicts; its range of "
            f"damping is the smaller one ({shown(ends[AKF])} against {shown(ends[FDM])} N·s/m).",
            "At B = 0 the estimator plays no part: both hold 2b/T.",
        ),
        conditions=("Exact, without friction, quantum and saturation; bilateral walls at 1 kHz.",),
        pictures=(Picture("theory", "Stable (solid) and passive (dashed, by upper edge of the band)."),),
        tables=(Table("K (kN/m)", ("", *(f"B = {chawda.linear_dampings[i]:g}" for i in chosen)), table),),
    )


def variants(chawda: Chawda) -> Section:
    """Levant's differentiator in other forms."""
    found = chawda.variants
    rows = []
    for number, name in enumerate(chawda.variant_names):
        width = found.width(0, 0, number)
        rows.append((name, shown(width.stiffness / 1e3), shown(width.damping), shown(width.worst_fidelity)))
    widths = [found.width(0, 0, number).stiffness for number in range(len(chawda.variant_names))]
    some = [k for k in widths if k > 0.0]
    said = f"from {shown(min(widths) / 1e3)} to {shown(max(widths) / 1e3)} kN/m"
    if some:
        said += f", × {shown(max(some) / min(some))} among those that hold a wall"
    return Section(
        key="variants",
        title="Levant's differentiator in other forms",
        text=(
            f"Discretisation, output and C change the K-width {said}. The paper names none of them but its gains; FDM+"
            f"filter has {of_spread(spread(chawda.widths(FDM), 'stiffness'), 1e3)} kN/m.",
        ),
        conditions=(
            f"1 kHz, μ1 = 1.1, μ2 = 1; main reading, one measurement, dampings "
            f"{', '.join(f'{b:g}' for b in found.grid.dampings)} N·s/m, stiffnesses "
            f"{100 * (found.grid.stiffnesses[1] / found.grid.stiffnesses[0] - 1):.2g} % apart.",
        ),
        tables=(
            Table("", ("form", "K-width (kN/m)", "B-width (N·s/m)", "largest error (N·s/m)"), tuple(rows)),
        ),
    )


# --- dual-rate -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Ranked:
    """One scheme on one rig by one reading: area of its Z-width, widths, and its error over that of Koul's wall."""

    scheme: Scheme
    area: Spread
    stiffness: Spread
    damping: Spread
    error: Spread  # ratio of mean errors at walls that both hold; the dual-rate wall of Koul et al. is 1
    capped: bool  # whether the region reaches the stiffest walls of the grid

    @property
    def said(self) -> str:
        """The area in words."""
        return f"{'≥ ' if self.capped else ''}{of_spread(self.area)}"


def ranked(found: Readings, reading: int) -> list[Ranked]:
    """Every scheme, the widest first."""
    schemes = found.grid.schemes
    reference = next(n for n, scheme in enumerate(schemes) if scheme == Scheme.parse(PAPERS_DUAL))
    rows = []
    for number, scheme in enumerate(schemes):
        widths = found.widths(reading, number)
        rows.append(
            Ranked(
                scheme,
                found.areas(reading, number),
                spread(widths, "stiffness"),
                spread(widths, "damping"),
                _relative_error(found, reading, number, reference),
                any(width.stiffness_capped for width in widths),
            )
        )
    return sorted(rows, key=lambda row: -row.area.mean)


def _relative_error(found: Readings, reading: int, number: int, reference: int) -> Spread:
    """Mean error over that of the reference at walls that both hold, by measurement."""
    ratios = []
    for m in range(found.grid.measurements):
        held = connected(found.passive[m, reading, number]) & connected(found.passive[m, reading, reference])
        if held.any():
            error = found.fidelity[m, reading]
            ratios.append(float(error[number][held].mean() / error[reference][held].mean()))
    return Spread.of(ratios)


def dual(chawda: Chawda) -> Section:
    """Which estimator inside the dual-rate scheme is widest, and which most faithful."""
    text, tables = [], []
    for preset in KOUL:
        found = chawda.dual[preset]
        for number, reading in enumerate(DUAL_READINGS):
            rows = ranked(found, number)
            text.append(_answer(preset, reading, rows))
            tables.append(
                Table(
                    f"{NAMES[preset]}, {reading.text}",
                    (
                        "scheme",
                        "area",
                        "K-width (N·m/rad)",
                        "B-width (N·m·s/rad)",
                        "error over 20k/2k fdm-butterworth",
                    ),
                    tuple(
                        (
                            row.scheme.text,
                            row.said,
                            of_spread(row.stiffness),
                            of_spread(row.damping),
                            of_spread(row.error),
                        )
                        for row in rows
                    ),
                )
            )
    grid = chawda.dual[KOUL[0]].grid
    x = grid.experiment.excitation
    return Section(
        key="dual",
        title="Beyond both papers: every estimator inside the dual-rate scheme",
        text=tuple(text),
        conditions=(
            "Koul's rigs, nobody holds them: a wall must be passive by the rig's own damping, which is little. "
            "Passivity of the whole band is asked for, so that the delay of the slow velocity counts. What holds in a "
            "hand, by hits, is another question: see rig reproduce koul.",
            f"Multisine {x.low_hz:g} to {x.high_hz:g} Hz every {1 / x.period_s:g} Hz, {grid.measurements} "
            f"measurements of {chawda.scale.dual_realisations} realisations; encoder counts on the rigid rig, true "
            "motion of the handle on the compliant one, where the encoder is on the other side of the capstan.",
            f"Grid: {len(grid.stiffnesses)} stiffnesses from {grid.stiffnesses[0]:g} to {grid.stiffnesses[-1]:g} "
            f"N·m/rad, dampings {', '.join(f'{b:g}' for b in grid.dampings)} N·m·s/rad. Estimators by their defaults, "
            "none tuned; a cut-off is a tenth of the velocity rate. Area: under the edge of the connected region; "
            "≥: the region goes on beyond the grid.",
        ),
        pictures=(
            Picture("dual", "Area of the Z-width by reading; bars: standard deviation over measurements."),
        ),
        tables=tuple(tables),
    )


def _answer(preset: str, reading: Reading, rows: list[Ranked]) -> str:
    duals = [row for row in rows if row.scheme.kind == "dual"]
    best = duals[0]
    near = [
        row for row in duals[1:] if best.area.mean - row.area.mean <= _doubt(best.area) + _doubt(row.area)
    ]
    told = [row for row in duals if row.error.count]
    uniform = max((row for row in rows if row.scheme.kind == "uniform"), key=lambda row: row.area.mean)
    if best.area.mean <= 0.0:
        return f"{NAMES[preset]}, {reading.text}: no dual-rate wall is passive."
    said = (
        f"{NAMES[preset]}, {reading.text}: widest is {best.scheme.text} ({best.said} in area"
        + (f"; not told apart from {', '.join(row.scheme.text for row in near)}" if near else "")
        + f"), × {shown(over(best.area.mean, uniform.area.mean))} of the best uniform one, {uniform.scheme.text}."
    )
    if told:
        true = min(told, key=lambda row: row.error.mean)
        said += (
            f" Most faithful at walls shared with the dual-rate wall of Koul et al.: {true.scheme.text} "
            f"(error × {of_spread(true.error)})."
        )
    return said


def _doubt(found: Spread) -> float:
    return float(np.nan_to_num(found.deviation))
