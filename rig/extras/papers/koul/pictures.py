"""Draw the pictures of the reproduction of Koul et al.; `PICTURES` has a drawing function for each picture's name.

`reproduction` calls them. They must not judge a claim.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rig.extras.papers.koul import rigs
from rig.extras.papers.koul import ways as koul_ways
from rig.extras.papers.koul.ideas import REFERENCE, Tried, rank_ideas
from rig.extras.papers.koul.impact_pictures import draw_figure_7, draw_figure_8
from rig.extras.papers.koul.results import Koul
from rig.extras.papers.koul.rules import LEVEL
from rig.views.plots import style
from rig.views.plots.zwidth import draw_boundaries, draw_zwidth

STIFFNESS, DAMPING = "stiffness K (N·m/rad)", "damping B (N·m·s/rad)"
ORDER = list(rigs.SCHEMES)
COLOUR = dict(zip(ORDER, style.SERIES, strict=False))


@style.own_style()
def _figure_5(koul: Koul, path: Path) -> None:
    figure = style.new_figure(11.0, 4.4)
    panels = figure.subplots(1, 2, sharey=True)
    rates = koul.scale.rates
    for axes, preset in zip(panels, rigs.PRESETS, strict=True):
        for number, lag in enumerate(rigs.LAGS):
            colour, found = style.SERIES[number], koul.kmax[preset, lag]
            draw_boundaries(axes, rates, found.curve("any"), colour, f"simulated, {lag}")
            axes.plot(
                rates,
                koul.kmax_theory[preset, lag],
                color=colour,
                linewidth=0.9,
                linestyle="--",
                label=f"linear theory, {lag}",
            )
        axes.plot([20_000], [LEVEL], "k*", markersize=11, label="Koul et al.")
        axes.set_xscale("log")
        top = max(b.highest for p in rigs.PRESETS for b in koul.kmax[p, rigs.WITH_LAG].curve("any"))
        axes.set_ylim(0.0, 1.6 * top)
        axes.set_xlabel("sampling rate 1/T1 (Hz)")
        axes.set_title(rigs.NAMES[preset], fontsize=10)
        style.lighten(axes)
    panels[0].set_ylabel("largest K at B = 0 (N·m/rad)")
    panels[0].legend(fontsize=8, loc="upper left")
    style.save(figure, path)


def _figure_6(koul: Koul, path: Path, preset: str) -> None:
    name = next(held.name for held in rigs.MAIN if held.preset == preset)
    curves = {
        ORDER.index(key): tuple(zip(*linear["curve"], strict=True))
        for key, linear in koul.linear[name].items()
    }
    draw_zwidth(koul.maps[name], path, theory=curves)  # type: ignore[arg-type]


@style.own_style()
def _hands(koul: Koul, path: Path) -> None:
    figure = style.new_figure(11.0, 4.4)
    panels = figure.subplots(1, 2)
    for axes, preset in zip(panels, rigs.PRESETS, strict=True):
        for number, held in enumerate(h for h in rigs.HELD if h.preset == preset):
            found, colour = koul.maps[held.name], style.SERIES[number]
            for key, look in ((rigs.DUAL, "-"), (rigs.FAST, ":")):
                curve = found.curve(ORDER.index(key), "any")
                label = held.push if key == rigs.DUAL else None
                x, y = [b.damping for b in curve], [b.stiffness for b in curve]
                axes.plot(x, y, look, color=colour, linewidth=1.6, label=label)
                capped = [(b.damping, b.stiffness) for b in curve if b.capped]
                if capped:
                    axes.plot(*zip(*capped, strict=True), "^", color=colour, markersize=5)
        _label(axes, f"{rigs.NAMES[preset]}: solid dual-rate, dotted uniform 20 kHz")
    panels[0].legend(fontsize=8)
    style.save(figure, path)


@style.own_style()
def _ways(koul: Koul, path: Path) -> None:
    keys = (rigs.DUAL, rigs.FAST, rigs.SLOW)
    figure = style.new_figure(12.0, 4.2)
    panels = figure.subplots(1, len(keys), sharey=True)
    for axes, key in zip(panels, keys, strict=True):
        columns = koul_ways.columns(koul.maps[rigs.MAIN[0].name], ORDER.index(key), "any")
        for passes, colour, label in ((True, "#b7dbc6", "holds"), (False, "#eec6c6", "fails")):
            points = [
                (column.damping, stiffness)
                for column in columns
                for stiffness, passed in column.tried.items()
                if passed is passes
            ]
            if points:
                axes.plot(*zip(*points, strict=True), "s", color=colour, markersize=5, label=label)
        dampings = [column.damping for column in columns]
        ladder, bisection = [column.ladder for column in columns], [column.bisection for column in columns]
        axes.plot(dampings, ladder, color=style.MEASURED, linewidth=1.6, label="ladder")
        axes.plot(dampings, bisection, "--", color=style.SENT, linewidth=1.4, label="bisection")
        axes.set_yscale("log")
        _label(axes, rigs.LABELS[key])
        axes.set_ylim(auto=True)
        axes.set_ylabel("")
    panels[0].set_ylabel(STIFFNESS)
    panels[0].legend(fontsize=8, loc="lower left")
    style.save(figure, path)


def _figure_7(koul: Koul, path: Path) -> None:
    draw_figure_7(koul.figure_7, path)


def _figure_8(koul: Koul, path: Path) -> None:
    draw_figure_8(koul.figure_8, path)


@style.own_style()
def _theory(koul: Koul, path: Path) -> None:
    figure = style.new_figure(11.0, 4.6)
    panels = figure.subplots(1, 2)
    for axes, held in zip(panels, rigs.MAIN, strict=True):
        top = 0.0
        for key, linear in koul.linear[held.name].items():
            b, k = zip(*linear["curve"], strict=True)
            top = max(top, linear["peak"])
            axes.plot(b, k, color=COLOUR[key], linewidth=1.6, label=rigs.LABELS[key])
            for at, low, high in linear["islands"]:
                axes.plot([at, at], [low, high], color=COLOUR[key], linewidth=4.0, alpha=0.3, zorder=0)
            axes.plot(*linear["passive_curve"], "--", color=COLOUR[key], linewidth=0.9)
        _label(axes, f"{rigs.NAMES[held.preset]}: dashed, passive below; bars, islands")
        axes.set_ylim(0.0, 1.15 * top)
    panels[0].legend(fontsize=8)
    style.save(figure, path)


@style.own_style()
def _effects(koul: Koul, path: Path) -> None:
    figure = style.new_figure(11.0, 4.0)
    left, right = figure.subplots(1, 2)
    linear = koul.linear[rigs.MAIN[0].name]
    names = ["linear theory", *rigs.EFFECTS]
    undamped = {
        key: [linear[key]["undamped"], *(koul.effects[name].undamped[key] for name in rigs.EFFECTS)]
        for key in (rigs.DUAL, rigs.SLOW)
    }
    ranges = {
        key: [linear[key]["range"], *(koul.effects[name].ranges[key]["any"].damping for name in rigs.EFFECTS)]
        for key in (rigs.DUAL, rigs.FAST, rigs.FAST_1K, rigs.SLOW)
    }
    _bars(left, names, undamped, "K at B = 0 (N·m/rad)", {rigs.DUAL: "20 kHz", rigs.SLOW: "2 kHz"})
    _bars(right, names, ranges, f"range of B at the softest wall {DAMPING.split(' ', 2)[2]}", rigs.LABELS)
    style.save(figure, path)


def _bars(
    axes: Any,
    names: Sequence[str],
    values: Mapping[str, Sequence[float]],
    label: str,
    legend: Mapping[str, str],
) -> None:
    width = 0.8 / len(values)
    for number, (key, heights) in enumerate(values.items()):
        x = np.arange(len(names)) + (number - (len(values) - 1) / 2) * width
        axes.bar(x, heights, width, color=COLOUR[key], label=legend[key])
    axes.set_xticks(np.arange(len(names)), names, fontsize=8)
    style.tidy(axes, label)
    axes.legend(fontsize=8)


@style.own_style()
def _plants(koul: Koul, path: Path) -> None:
    figure = style.new_figure(11.0, 4.2)
    left, right = figure.subplots(1, 2)
    ranges = np.array([plant["ranges"] for plant in koul.plants])
    dual, fast, slow = (ranges[:, ORDER.index(key)] for key in (rigs.DUAL, rigs.FAST, rigs.SLOW))
    stiffness = np.array([plant["transmission_stiffness"] for plant in koul.plants])
    ends = [max(1e-3, ranges[:, ORDER.index(rigs.DUAL)].min()), dual.max()]
    left.plot(ends, ends, color=style.WALL, linewidth=1.0)
    left.plot(slow, dual, "o", color=style.MEASURED, markersize=4, alpha=0.6)
    left.set_xlabel("range of B, uniform 2 kHz (N·m·s/rad)")
    style.tidy(left, "range of B, dual-rate (N·m·s/rad)")
    right.plot(stiffness, fast / np.maximum(dual, 1e-9), "o", color=style.SENT, markersize=4, alpha=0.6)
    right.axhline(0.515, color="k", linewidth=1.0, label="Koul et al.")
    right.set_xscale("log")
    right.set_yscale("log")
    right.set_xlabel("stiffness of the capstan (N·m/rad)")
    style.tidy(right, "range of uniform 20 kHz over dual-rate")
    right.legend(fontsize=8)
    style.save(figure, path)


GROUPS = ("extrapolation", "adaptive T2", "T2", "cut-off", "encoder", "estimator")


@style.own_style()
def _ideas(koul: Koul, path: Path) -> None:
    figure = style.new_figure(13.0, 8.0)
    panels = figure.subplots(2, 3).ravel()
    reference = koul.ideas[REFERENCE]
    for axes, group in zip(panels, GROUPS, strict=True):
        shown = [t for t in koul.ideas.values() if t.idea.group == group]
        if group == "encoder":
            shown = [t for t in shown if t.idea.preset == reference.idea.preset]
        _idea_curve(axes, reference, "k", 2.2)
        for number, tried in enumerate(shown):
            _idea_curve(axes, tried, style.SERIES[number % len(style.SERIES)], 1.3)
        _label(axes, group)
        axes.legend(fontsize=6.5)
    figure.suptitle(
        "walls neither felt nor heard nor moved, koul-compliant (fitted), normal hand", fontsize=11
    )
    style.save(figure, path)


def _idea_curve(axes: Any, tried: Tried, colour: str, width: float) -> None:
    curve = tried.map.curve(0, "any")
    x, y = [b.damping for b in curve], [b.stiffness for b in curve]
    axes.plot(x, y, color=colour, linewidth=width, label=tried.idea.label)


@style.own_style()
def _ranking(koul: Koul, path: Path) -> None:
    ranked = rank_ideas(koul.ideas)
    figure = style.new_figure(10.0, 0.6 + 0.24 * len(ranked))
    axes = figure.subplots()
    areas = [one.area("any") for one in ranked]
    colours = [
        "k" if one.idea.key == REFERENCE else style.SERIES[GROUPS.index(one.idea.group)] for one in ranked
    ]
    place = np.arange(len(ranked))[::-1]
    axes.barh(place, areas, color=colours, height=0.7)
    axes.set_yticks(place, [f"{one.idea.group}: {one.idea.label}" for one in ranked], fontsize=7.5)
    axes.set_xlabel("area of the Z-width (N·m/rad × N·m·s/rad), neither felt nor heard nor moved")
    style.lighten(axes)
    style.save(figure, path)


def _label(axes: Any, title: str) -> None:
    axes.set_xlabel(DAMPING)
    axes.set_ylabel(STIFFNESS)
    axes.set_title(title, fontsize=9)
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0) if axes.get_yscale() == "linear" else None
    style.lighten(axes)


PICTURES: dict[str, Callable[[Koul, Path], None]] = {
    "figure-5": _figure_5,
    **{f"figure-6-{preset}": partial(_figure_6, preset=preset) for preset in rigs.PRESETS},
    "hands": _hands,
    "ways": _ways,
    "figure-7": _figure_7,
    "figure-8": _figure_8,
    "theory": _theory,
    "effects": _effects,
    "plants": _plants,
    "ranking": _ranking,
    "ideas": _ideas,
}
