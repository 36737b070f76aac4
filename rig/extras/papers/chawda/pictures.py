"""Draw the pictures of the reproduction of Chawda et al.; `PICTURES` has a drawing function for each picture's name.

`reproduction` calls them. They must not judge a claim.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rig.analysis.impedance import ideal_wall
from rig.core.deferred import colors
from rig.experiments.mapping.interface import connected
from rig.extras.papers.chawda import derived, rigs
from rig.extras.papers.chawda.levant_plot import draw_levant_regions, levant_regions
from rig.extras.papers.chawda.results import Chawda, spread
from rig.views.plots import style
from rig.views.plots.impedance import draw_impedance
from rig.views.plots.zwidth import draw_boundaries

DAMPING, STIFFNESS = "damping B (N·s/m)", "stiffness K (kN/m)"
ORDER = list(rigs.SCHEMES)
COLOUR = dict(zip(ORDER, style.SERIES, strict=False))
NOT_PASSIVE = "#ececec"


def _figure_1(_: Chawda, path: Path) -> None:
    draw_levant_regions(levant_regions(), path)


@style.own_style()
def _figure_3(chawda: Chawda, path: Path) -> None:
    figure = style.new_figure(11.0, 4.6)
    panels = figure.subplots(1, 2, sharey=True)
    main = dict.fromkeys((rigs.FILTERED, rigs.HBA_SC, rigs.LFBA, chawda.adjusted))
    for axes, criterion in zip(panels, ("felt", "heard"), strict=True):
        for number, name in enumerate(main):
            curve = chawda.hits.curve(chawda.hit_names.index(name), criterion)
            label = f"adjusted: {name}" if name == chawda.adjusted else name
            draw_boundaries(axes, [b.damping for b in curve], curve, style.SERIES[number], label)
        _by_damping(axes, f"stable and not {criterion}", "stiffness K (N/m)")
    panels[0].legend(fontsize=8)
    style.save(figure, path)


@style.own_style()
def _figure_3_gains(chawda: Chawda, path: Path) -> None:
    figure = style.new_figure(11.0, 4.6)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, kind in zip(panels, rigs.GAINS, strict=True):
        names = [name for name in chawda.hit_names if name.startswith(f"{kind}, C")]
        for number, name in enumerate(names):
            curve = chawda.hits.curve(chawda.hit_names.index(name), "felt")
            label = name.removeprefix(f"{kind}, ")
            draw_boundaries(axes, [b.damping for b in curve], curve, style.SERIES[number], label)
        _by_damping(axes, f"{kind}, stable and not felt", "stiffness K (N/m)")
        axes.legend(fontsize=8)
    style.save(figure, path)


@style.own_style()
def _hits(chawda: Chawda, path: Path) -> None:
    figure = style.new_figure(7.0, 4.6)
    axes = figure.subplots()
    for number, name in enumerate(rigs.SCHEMES):
        curve = chawda.slow_hits.curve(number, "felt")
        draw_boundaries(axes, [b.damping for b in curve], curve, COLOUR[name], name)
        if name in chawda.linear:
            axes.plot(
                chawda.linear_dampings, chawda.linear[name]["stable"], "--", color=COLOUR[name], linewidth=0.9
            )
    _by_damping(axes, "hits at 1 kHz, stable and not felt; dashed: linear theory", "stiffness K (N/m)")
    axes.legend(fontsize=8)
    style.save(figure, path)


def _figure_4(chawda: Chawda, path: Path) -> None:
    draw_impedance(chawda.impedances[:2], path)


@style.own_style()
def _figure_6(chawda: Chawda, path: Path) -> None:
    figure = style.new_figure(9.0, 6.4)
    size, error = figure.subplots(2, 1, sharex=True)
    for name, result in zip(rigs.SCHEMES, chawda.impedances[1:], strict=True):
        measured = result.impedance
        if measured is None:
            continue
        ideal = np.abs(ideal_wall(*result.wall, measured.lines_hz))
        if name == rigs.FDM:
            size.plot(measured.lines_hz, ideal, "k--", linewidth=1.0, label="ideal K/(jω) + B")
        size.plot(measured.lines_hz, measured.magnitude, color=COLOUR[name], linewidth=1.0, label=name)
        error.plot(measured.lines_hz, measured.magnitude - ideal, color=COLOUR[name], linewidth=1.0)
    size.set_xscale("log")
    size.set_yscale("log")
    style.tidy(size, "|Z| (N·s/m)")
    style.tidy(error, "|Z| less ideal (N·s/m)")
    error.set_xlabel("frequency (Hz)")
    size.legend(fontsize=8)
    style.save(figure, path)


def _figure_5(chawda: Chawda, path: Path) -> None:
    figure, panels = _panels()
    for axes, name in zip(panels, rigs.SCHEMES, strict=True):
        passive = chawda.map.passive[0, rigs.MAIN, ORDER.index(name)]
        stiffness_places, damping_places = _places(chawda)
        cells = np.where(passive, 1.0, np.nan).T
        axes.set_facecolor(NOT_PASSIVE)
        look = {"cmap": "Blues", "vmin": 0.0, "vmax": 2.5, "edgecolor": "white", "linewidth": 0.2}
        axes.pcolormesh(_edges(damping_places), _edges(stiffness_places), cells, **look)
        search = chawda.search(name)
        path_b, path_k = zip(*search.path, strict=True)
        axes.plot(path_b, path_k, "-", color=style.BAD, linewidth=1.2, marker=".", markersize=3)
        axes.set_title(f"{name}: {len(search.path)} of {search.cells} tests, {search.ending}", fontsize=9)
        _ticks(axes, chawda)
    style.save(figure, path)


def _figure_7(chawda: Chawda, path: Path) -> None:
    figure, panels = _panels()
    errors = chawda.map.fidelity[:, rigs.MAIN]
    seen = errors[np.isfinite(errors) & chawda.map.passive[:, rigs.MAIN]]
    norm = colors.LogNorm(float(seen.min()), float(seen.max())) if len(seen) else colors.LogNorm(1.0, 10.0)
    stiffness_places, damping_places = _places(chawda)
    mesh = None
    for axes, name in zip(panels, rigs.SCHEMES, strict=True):
        number = ORDER.index(name)
        passive = chawda.map.passive[:, rigs.MAIN, number]
        held = connected(passive).mean(axis=0) > 0.5
        shown = np.where(held, _seen_mean(errors[:, number]), np.nan)
        axes.set_facecolor(NOT_PASSIVE)
        mesh = axes.pcolormesh(
            _edges(damping_places), _edges(stiffness_places), shown.T, cmap="viridis", norm=norm
        )
        islands = passive[0] & ~connected(passive[0])
        if islands.any():
            hatched = {"levels": [0.5, 1.5], "colors": "none", "hatches": ["////"]}
            axes.contourf(damping_places, stiffness_places, np.where(islands, 1.0, 0.0).T, **hatched)
        if name in chawda.linear:
            _linear_lines(axes, chawda, name)
        axes.set_title(name, fontsize=10)
        _ticks(axes, chawda)
    figure.colorbar(mesh, ax=list(panels), label="fidelity error (N·s/m)", shrink=0.8)
    style.save(figure, path)


def _linear_lines(axes: Any, chawda: Chawda, name: str) -> None:
    grid, linear = chawda.map.grid, chawda.linear[name]
    damping_places = np.interp(chawda.linear_dampings, grid.dampings, np.arange(len(grid.dampings)))
    passive = linear["passive"][rigs.HIGHEST_HZ.index(rigs.READINGS[rigs.MAIN].high_hz)]
    for stiffness, look in ((linear["stable"], "--"), (passive, ":")):
        stiffness_places = np.interp(
            np.log(stiffness), np.log(grid.stiffnesses), np.arange(len(grid.stiffnesses))
        )
        axes.plot(damping_places, stiffness_places, look, color=style.BAD, linewidth=1.2)


def _seen_mean(values: Any) -> Any:
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)


@style.own_style()
def _panels() -> tuple[Any, Any]:
    figure = style.new_figure(11.0, 8.4)
    return figure, figure.subplots(2, 2, sharex=True, sharey=True).ravel()


def _places(chawda: Chawda) -> tuple[Any, Any]:
    grid = chawda.map.grid
    return np.arange(len(grid.stiffnesses)), np.arange(len(grid.dampings))


def _edges(centres: Any) -> Any:
    return np.append(centres, centres[-1] + 1) - 0.5


def _ticks(axes: Any, chawda: Chawda) -> None:
    grid = chawda.map.grid
    every = max(1, len(grid.stiffnesses) // 8)
    axes.set_xticks(range(len(grid.dampings)), [f"{b:g}" for b in grid.dampings], fontsize=8)
    axes.set_yticks(
        range(0, len(grid.stiffnesses), every),
        [f"{k / 1e3:.3g}" for k in grid.stiffnesses[::every]],
        fontsize=8,
    )
    axes.set_xlabel(DAMPING)
    axes.set_ylabel(STIFFNESS)


@style.own_style()
def _readings(chawda: Chawda, path: Path) -> None:
    figure = style.new_figure(12.0, 7.0)
    panels = figure.subplots(2, len(rigs.SCHEMES), sharex=True, sharey="row")
    least = derived.floors()
    for column, name in enumerate(rigs.SCHEMES):
        for number, (tolerance, kind) in enumerate(rigs.TOLERANCES):
            read = [
                rigs.READINGS.index(
                    rigs.Reading(low_hz=rigs.LOWEST_HZ[0], high_hz=high, tolerance=tolerance, kind=kind)
                )
                for high in rigs.HIGHEST_HZ
            ]
            label = rigs.READINGS[read[0]].allowed
            for row, what in enumerate(("stiffness", "worst_fidelity")):
                found = [spread(chawda.widths(name, one), what) for one in read]
                scale = 1e3 if row == 0 else 1.0
                panels[row, column].errorbar(
                    rigs.HIGHEST_HZ,
                    [one.mean / scale for one in found],
                    [np.nan_to_num(one.deviation) / scale for one in found],
                    color=style.SERIES[number],
                    linewidth=1.2,
                    marker=".",
                    capsize=2,
                    label=label,
                )
        panels[0, column].axhline(rigs.PRINTED[name].stiffness / 1e3, color="k", linewidth=1.0, linestyle=":")
        panels[1, column].axhline(rigs.PRINTED[name].worst_fidelity, color="k", linewidth=1.0, linestyle=":")
        panels[1, column].plot(
            rigs.HIGHEST_HZ, [least[high] for high in rigs.HIGHEST_HZ], "k--", linewidth=0.8
        )
        panels[0, column].set_title(name, fontsize=10)
        panels[0, column].set_yscale("symlog", linthresh=4.0)
        panels[1, column].set_xlabel("upper edge of the band (Hz)")
        for axes in panels[:, column]:
            style.lighten(axes)
    panels[0, 0].set_ylabel("K-width (kN/m)")
    panels[1, 0].set_ylabel("largest error (N·s/m)")
    panels[0, 0].legend(fontsize=7)
    figure.suptitle("dotted: Table I; dashed: error without a wall", fontsize=10)
    style.save(figure, path)


@style.own_style()
def _theory(chawda: Chawda, path: Path) -> None:
    figure = style.new_figure(11.0, 4.6)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, name in zip(panels, (rigs.FDM, rigs.AKF), strict=True):
        of = chawda.linear[name]
        axes.plot(chawda.linear_dampings, np.array(of["stable"]) / 1e3, "k", linewidth=1.6, label="stable")
        for number, (high, passive) in enumerate(zip(rigs.HIGHEST_HZ, of["passive"], strict=True)):
            axes.plot(
                chawda.linear_dampings,
                np.array(passive) / 1e3,
                "--",
                color=style.SERIES[number],
                linewidth=1.2,
                label=f"passive up to {high:g} Hz",
            )
        _by_damping(axes, name, STIFFNESS)
    panels[0].set_ylim(0.0, 1.05e-3 * max(max(of["stable"]) for of in chawda.linear.values()))
    panels[0].legend(fontsize=8)
    style.save(figure, path)


@style.own_style()
def _dual(chawda: Chawda, path: Path) -> None:
    figure = style.new_figure(11.0, 7.0)
    panels = figure.subplots(1, len(rigs.KOUL), sharey=True)
    texts = [scheme.text for scheme in chawda.dual_schemes]
    place = np.arange(len(texts))[::-1]
    for axes, preset in zip(panels, rigs.KOUL, strict=True):
        width = 0.8 / len(rigs.DUAL_READINGS)
        for number, reading in enumerate(rigs.DUAL_READINGS):
            rows = {row.scheme.text: row for row in derived.rank_schemes(chawda.dual[preset], number)}
            axes.barh(
                place + (1 - number) * width,
                [rows[text].area.mean for text in texts],
                width,
                xerr=[np.nan_to_num(rows[text].area.deviation) for text in texts],
                color=style.SERIES[number],
                label=f"passive up to {reading.high_hz:g} Hz",
            )
        axes.set_yticks(place, [text.replace("estimator=", "") for text in texts], fontsize=7.5)
        axes.set_xlabel("area (N·m/rad × N·m·s/rad)")
        axes.set_title(rigs.NAMES[preset], fontsize=10)
        style.lighten(axes)
    panels[0].legend(fontsize=8)
    style.save(figure, path)


def _by_damping(axes: Any, title: str, label: str) -> None:
    axes.set_xlabel(DAMPING)
    axes.set_title(title, fontsize=9)
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)
    style.tidy(axes, label)


PICTURES: Mapping[str, Callable[[Chawda, Path], None]] = {
    "figure-1": _figure_1,
    "figure-3": _figure_3,
    "figure-3-gains": _figure_3_gains,
    "hits": _hits,
    "figure-4": _figure_4,
    "figure-5": _figure_5,
    "figure-6": _figure_6,
    "figure-7": _figure_7,
    "readings": _readings,
    "theory": _theory,
    "dual": _dual,
}
