"""Sections of the report on Chawda et al. about its maps: the boundary search, the maps themselves, Table I."""

from __future__ import annotations

import math

from rig.experiments.table_one import FrequencyWidth, Spread, tuned_numbers
from rig.papers.chawda.claims_fidelity import common_gains
from rig.papers.chawda.results import Chawda, spread
from rig.papers.chawda.rigs import AKF, FDM, FILTERS, FOAW, MAIN, PRINTED, READINGS, SCHEMES
from rig.papers.frame import Picture, Section, Table, shown

READING = (
    f"Main reading: {READINGS[MAIN].text}, less than a tenth of the motion's power off the lines: what this program "
    "does when nobody says otherwise."
)


def grid_of(chawda: Chawda) -> str:
    """The grid in words."""
    grid = chawda.map.grid
    return (
        f"Grid: {len(grid.stiffnesses)} stiffnesses from {grid.stiffnesses[0] / 1e3:g} to "
        f"{grid.stiffnesses[-1] / 1e3:g} kN/m in equal ratios, dampings {', '.join(f'{b:g}' for b in grid.dampings)} "
        f"N·s/m; {grid.measurements} measurements of {chawda.scale.realisations} realisations."
    )


def figure_5(chawda: Chawda) -> Section:
    """The boundary search in the first measurement's maps."""
    rows = []
    stiffnesses = chawda.map.grid.stiffnesses
    for name in SCHEMES:
        for measurement in range(chawda.map.grid.measurements):
            search = chawda.search(name, measurement)
            rows.append(
                (
                    f"{name}, measurement {measurement + 1}",
                    f"{len(search.path)} of {search.cells}",
                    shown(stiffnesses[search.highest] / 1e3) if search.highest >= 0 else "–",
                    shown(chawda.widths(name)[measurement].stiffness / 1e3),
                    str(search.above),
                    str(search.below),
                    str(search.unseen),
                    search.ending,
                )
            )
    wrong = sum(int(row[4]) + int(row[5]) + int(row[6]) for row in rows)
    return Section(
        key="figure-5",
        title="Fig. 5: the paper's boundary search",
        text=(
            f"Walking along the boundary needs a small part of the grid's tests. It believes that each damping has one "
            f"edge: at {wrong} of {len(rows) * len(chawda.map.grid.dampings)} dampings it ends elsewhere than the edge "
            "of the connected region, because single walls fail below it or pass beyond it.",
        ),
        conditions=(READING, grid_of(chawda), "The search starts at the softest wall without damping."),
        pictures=(Picture("figure-5", "Path of the search over the map of the first measurement."),),
        tables=(
            Table(
                "search against grid; K in kN/m",
                (
                    "map",
                    "tests",
                    "K found",
                    "K-width of the grid",
                    "on islands",
                    "below",
                    "unseen",
                    "ended by",
                ),
                tuple(rows),
            ),
        ),
    )


def figure_7(chawda: Chawda) -> Section:
    """The maps."""
    islands = {name: [len(width.islands) for width in chawda.widths(name)] for name in SCHEMES}
    return Section(
        key="figure-7",
        title="Fig. 7: passive walls, coloured by their fidelity error",
        text=(
            "Where passive walls end, single ones pass and fail at random: "
            + "; ".join(f"{name} {min(of)} to {max(of)} islands" for name, of in islands.items())
            + " beyond the connected region. The error is largest at soft walls, where the rig's mass stands alone.",
        ),
        conditions=(
            READING,
            grid_of(chawda),
            "Error: rms over the band of |Z| − |K/(jω) + B|, mean of the measurements.",
        ),
        pictures=(
            Picture(
                "figure-7",
                "Coloured: passive in more than half of the measurements and connected; hatched: islands of the first "
                "measurement; lines: closed form without friction and quantum, stable (dashed) and passive (dotted).",
            ),
        ),
    )


def of_spread(found: Spread, scale: float = 1.0) -> str:
    """Mean ± standard deviation."""
    if found.count == 0:
        return "–"
    deviation = f" ± {shown(found.deviation / scale)}" if math.isfinite(found.deviation) else ""
    return f"{shown(found.mean / scale)}{deviation}"


def table_1(chawda: Chawda) -> Section:
    """Table I beside the paper's."""
    rows = []
    stiff = {name: chawda.widths(name) for name in SCHEMES}
    x = chawda.map.grid.experiment
    for name, scheme in SCHEMES.items():
        widths, printed = stiff[name], PRINTED[name]
        controller = scheme.applied(x).controller
        rows.append(
            (
                name,
                _capped(of_spread(spread(widths, "stiffness"), 1e4), widths, "stiffness"),
                shown(printed.stiffness / 1e4),
                _capped(of_spread(spread(widths, "damping")), widths, "damping"),
                shown(printed.damping),
                of_spread(spread(widths, "worst_fidelity")),
                shown(printed.worst_fidelity),
                of_spread(_common(chawda, name)),
                str(len(tuned_numbers(controller.estimator, controller.parameters))),
                str(printed.tunable),
            )
        )
    gains = common_gains(chawda)
    worst = {name: [(w.worst_stiffness, w.worst_damping) for w in of] for name, of in stiff.items()}
    softest = chawda.map.grid.stiffnesses[0]
    at_softest = sum(k == softest for of in worst.values() for k, _ in of)
    total = sum(len(of) for of in worst.values())
    return Section(
        key="table-1",
        title="Table I",
        text=(
            f"The largest error stands at the softest wall of the grid in {at_softest} of {total} maps: it says how "
            "much mass the band shows, not what the estimator does."
            + (
                f" At walls that {FDM}, {FOAW} and {AKF} all hold FOAW's mean error is "
                + " and ".join(
                    f"{shown(1 - max(of))} to {shown(1 - min(of))} times that of {name}"
                    for name, of in gains.items()
                )
                + "."
                if gains
                else ""
            ),
            "Mean ± standard deviation over measurements; the grid's own step is "
            f"{100 * (chawda.map.grid.stiffnesses[1] / softest - 1):.2g} % in K.",
        ),
        conditions=(
            READING,
            grid_of(chawda),
            "K-width: stiffest wall connected with the softest of its damping; ≥: end of the grid.",
        ),
        tables=(
            Table(
                "this run, and the paper's experiment (printed)",
                (
                    "estimator",
                    "K-width (10⁴ N/m)",
                    "printed",
                    "B-width (N·s/m)",
                    "printed",
                    "largest error (N·s/m)",
                    "printed",
                    f"error at walls that {', '.join((FDM, FOAW, AKF))} hold",
                    "numbers to tune",
                    "printed",
                ),
                tuple(rows),
            ),
        ),
    )


def _capped(text: str, widths: list[FrequencyWidth], name: str) -> str:
    return f"{'≥ ' if any(getattr(width, name + '_capped') for width in widths) else ''}{text}"


def _common(chawda: Chawda, name: str) -> Spread:
    if name not in FILTERS:
        return Spread.of([])
    numbers = [list(SCHEMES).index(one) for one in FILTERS]
    held = chawda.map.common(MAIN, numbers)
    of = chawda.map.fidelity[:, MAIN, list(SCHEMES).index(name)]
    return Spread.of([float(one[held].mean()) for one in of] if held.any() else [])
