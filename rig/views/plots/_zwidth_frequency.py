"""Draw maps of passive walls (damping B, stiffness K), coloured by fidelity error, like Chawda et al., Figs. 7 and 8.

There is one panel for each scheme, and one colour scale for all panels. A cell is one wall. Cells without hatching are
connected with the softest wall of their damping, hatched cells are islands. Grey walls were not passive; dark grey
walls drove the handle out of its limits. Lines show the boundary search of the paper's Fig. 5 and the limits by linear
theory: dashed for stability, dotted for passivity in the band.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from rig.analysis.impedance import Floats
from rig.core.deferred import colors
from rig.core.sample import unit_of
from rig.experiments.mapping.interface import FrequencyMap, FrequencyWidth, trace_grid
from rig.views.plots import style

# Dampings, stable stiffness, passive stiffness.
Curves = tuple[Sequence[float], Sequence[float], Sequence[float]]
# Panels in a row, unless there are more than four panels.
COLUMNS = 2
COLOURS = "viridis"
ACTIVE, ENDED = "#ececec", "#bdbdbd"
SEARCH = "#d01c8b"
TITLE_WIDTH = 60


def draw_frequency_map(
    found: FrequencyMap,
    picture: str | Path,
    *,
    theory: Mapping[int, Curves] | None = None,
    search: bool = True,
    realisation: int = -1,
) -> Path:
    """Draw a map of passive walls into a file and return its path; the ending of `picture` selects the format.

    `theory` has the largest stable and passive stiffness over damping by scheme index, `search` draws the path of the
    boundary search, `realisation` is the index of a measurement with its own random phases (−1: all together). Raise
    `RecordingError` if the file cannot be written.
    """
    figure = frequency_figure(found, theory=theory, search=search, realisation=realisation)
    return style.save(figure, Path(picture))


@style.own_style()
def frequency_figure(
    found: FrequencyMap,
    *,
    theory: Mapping[int, Curves] | None = None,
    search: bool = True,
    realisation: int = -1,
) -> Any:
    """Return the matplotlib figure of a map of passive walls.

    `theory` has stiffness limits over damping by scheme index, `search` draws the boundary search, `realisation` is the
    index of a measurement (−1: all together).
    """
    plan = found.plan
    count = len(plan.schemes)
    columns = min(count, COLUMNS if count <= COLUMNS**2 else COLUMNS + 1)
    rows = math.ceil(count / columns)
    figure = style.new_figure(4.9 * columns + 0.9, 4.0 * rows + 0.6)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    passive, fidelity = found.passive[:, realisation], found.fidelity[:, realisation]
    low, high = _scale(fidelity[passive])
    mesh = None
    for number, axes in enumerate(panels.flat):
        if number >= count:
            axes.set_visible(False)
            continue
        mesh = _draw_cells(
            axes, plan.dampings, plan.stiffnesses, passive[number], fidelity[number], low, high
        )
        _draw_theory(axes, (theory or {}).get(number))
        if search:
            _draw_search(axes, plan.dampings, plan.stiffnesses, passive[number])
        axes.set_title(fill(plan.schemes[number].label(plan.experiment), TITLE_WIDTH), fontsize=9)
        axes.set_ylim(*_ends(plan.stiffnesses))
        axes.set_xlim(*_ends(plan.dampings))
    motion = plan.experiment.rig.motion
    for axes in panels[-1]:
        axes.set_xlabel(f"damping B ({unit_of('damping', motion)})")
    for axes in panels[:, 0]:
        axes.set_ylabel(f"stiffness K ({unit_of('stiffness', motion)})")
    if mesh is not None:
        bar = figure.colorbar(mesh, ax=panels, shrink=0.9)
        bar.set_label(f"fidelity: rms of |Z| − |K/(jω) + B| ({unit_of('damping', motion)})")
    (low_hz, high_hz), excitation = plan.band_hz, plan.experiment.excitation
    figure.suptitle(
        f"{plan.experiment.rig.name}: passive from {low_hz:g} to {high_hz:g} Hz, "
        f"{excitation.realisations} × {excitation.periods} periods of {excitation.period_s:g} s",
        fontsize=11,
    )
    return figure


def _draw_cells(
    axes: Any,
    dampings: Sequence[float],
    stiffnesses: Sequence[float],
    passive: Any,
    fidelity: Any,
    low: float,
    high: float,
) -> Any:
    edges = damping_edges, stiffness_edges = _edges(dampings), _edges(stiffnesses)
    axes.set_facecolor(ACTIVE)
    ended = np.where(np.isnan(fidelity), 0.0, math.nan)
    axes.pcolormesh(*edges, ended.T, cmap=colors.ListedColormap([ENDED]), linewidth=0, rasterized=True)
    shown = np.where(passive, fidelity, math.nan)
    mesh = axes.pcolormesh(*edges, shown.T, cmap=COLOURS, vmin=low, vmax=high, linewidth=0, rasterized=True)
    for island in FrequencyWidth.of(passive, fidelity, stiffnesses, dampings).islands:
        column = dampings.index(island.damping)
        first, last = stiffnesses.index(island.lowest), stiffnesses.index(island.highest)
        axes.fill_between(
            damping_edges[[column, column + 1]],
            stiffness_edges[first],
            stiffness_edges[last + 1],
            facecolor="none",
            hatch="////",
            edgecolor="white",
            linewidth=0.0,
        )
    return mesh


def _draw_theory(axes: Any, curves: Curves | None) -> None:
    if curves is None:
        return
    dampings, stable, passive = curves
    axes.plot(dampings, stable, color="black", linewidth=1.0, linestyle="--", label="linear: stable")
    axes.plot(dampings, passive, color="black", linewidth=1.2, linestyle=":", label="linear: passive in band")
    axes.legend(fontsize=7, loc="upper right", framealpha=0.85, edgecolor="none")


def _draw_search(axes: Any, dampings: Sequence[float], stiffnesses: Sequence[float], passive: Any) -> None:
    found = trace_grid(passive)
    path = [(dampings[column], stiffnesses[row]) for column, row in found.path]
    axes.plot(*np.array(path).reshape(-1, 2).T, color=SEARCH, linewidth=1.0, alpha=0.9)
    ends = [(dampings[column], stiffnesses[row]) for column, row in found.edge if row >= 0]
    if ends:
        axes.plot(*zip(*ends, strict=True), "o", color=SEARCH, markersize=3.0)
    axes.text(
        0.02,
        0.98,
        f"search: {len(path)} of {found.cells} walls, {found.ending}",
        transform=axes.transAxes,
        fontsize=7,
        va="top",
        color=SEARCH,
        bbox={"facecolor": "white", "alpha": 0.85, "linewidth": 0.0, "pad": 1.5},
    )


def _scale(values: Floats) -> tuple[float, float]:
    """Return the ends of the colour scale: smallest error, and 98 % quantile, above which errors have one colour."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(np.percentile(finite, 98.0))
    return low, high if high > low else low + 1.0


def _edges(values: Sequence[float]) -> Floats:
    centres = np.asarray(values, dtype=np.float64)
    if len(centres) == 1:
        half = 0.5 * max(abs(float(centres[0])), 1e-9)
        return np.array([centres[0] - half, centres[0] + half])
    between = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2.0 * centres[0] - between[0]], between, [2.0 * centres[-1] - between[-1]]])


def _ends(values: Sequence[float]) -> tuple[float, float]:
    edges = _edges(values)
    return max(0.0, float(edges[0])), float(edges[-1])
