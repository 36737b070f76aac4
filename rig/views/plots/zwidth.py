"""Draw Z-width maps: largest stable stiffness K of each sampling scheme over damping B, or at B = 0 over the rate.

For a map with a single damping the limits of the schemes are drawn side by side. Circles are means over encoder offsets
and repeats.

``rig/views/table.json`` registers the maps; designs and papers draw single boundaries. This file must not run a hit.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rig.core.sample import unit_of
from rig.experiments.mapping.interface import RENDERED, Boundary, KMax, ZWidth
from rig.views.plots import style

TITLES = {"felt": "felt", "heard": "heard", "any": "felt, heard or moved"}
_THEORY: dict[str, Any] = {"linewidth": 0.8, "linestyle": "--"}
_BAND: dict[str, Any] = {"alpha": 0.18, "linewidth": 0.0}
_CAP: dict[str, Any] = {"marker": "^", "linestyle": "", "markersize": 7}
_HOLE: dict[str, Any] = {"marker": "x", "linestyle": "", "markersize": 7, "zorder": 5, "clip_on": False}
_NOT_RENDERED: dict[str, Any] = {
    "marker": "o",
    "markerfacecolor": "white",
    "linestyle": "",
    "markersize": 4,
    "zorder": 5,
}
_ISLAND: dict[str, Any] = {"linewidth": 3.0, "alpha": 0.45, "solid_capstyle": "butt"}
Curve = tuple[Sequence[float], Sequence[float]]  # damping or rate, stiffness


def draw_zwidth(
    found: ZWidth,
    picture: str | Path,
    *,
    theory: Mapping[int, Curve] | None = None,
    criteria: Sequence[str] = ("felt", "heard"),
) -> Path:
    """Draw a map of stable walls into a file, with a panel for each of `criteria`; return the file's path.

    `theory` has dampings and stiffness limits by scheme index; "felt" and "heard" are ripples of velocity and effort.
    """
    return style.save(zwidth_figure(found, theory=theory, criteria=criteria), Path(picture))


@style.own_style()
def zwidth_figure(
    found: ZWidth,
    *,
    theory: Mapping[int, Curve] | None = None,
    criteria: Sequence[str] = ("felt", "heard"),
) -> Any:
    """Return the matplotlib figure of a map of stable walls, with a panel for each of `criteria`.

    `theory` has dampings and stiffness limits by scheme index; "felt" and "heard" are ripples of velocity and effort.
    """
    experiment, dampings = found.plan.experiment, found.plan.dampings
    alone = len(dampings) == 1
    highest = max(boundary.highest for boundary in found.boundaries)
    unit = unit_of("damping", experiment.rig.motion)
    figure = style.new_figure(4.6 * len(criteria) + 0.6, 4.6)
    panels = figure.subplots(1, len(criteria), sharey=True, squeeze=False)[0]
    for axes, criterion in zip(panels, criteria, strict=True):
        for number, scheme in enumerate(found.plan.schemes):
            colour = style.SERIES[number % len(style.SERIES)]
            curve = found.curve(number, criterion)
            along = [float(number)] if alone else [boundary.damping for boundary in curve]
            draw_boundaries(axes, along, curve, colour, scheme.label(experiment))
            if theory and number in theory:
                at, limits = theory[number]
                across = ([number - 0.3, number + 0.3], [limits[0], limits[0]])
                axes.plot(*(across if alone else (at, limits)), color=colour, **_THEORY)
        axes.set_title(f"stable and not {TITLES[criterion]}", fontsize=10)
        _from_zero(axes, found, max(highest, axes.dataLim.y1) if alone else highest)
        if alone:
            axes.set(xticks=[], xlim=(-0.7, len(found.plan.schemes) - 0.3))
            axes.set_xlabel(f"scheme, at B = {dampings[0]:g} {unit}")
        else:
            axes.set_xlim(left=-0.02 * max(dampings))  # a marker at B = 0 is not cut in half
            axes.set_xlabel(f"damping B ({unit})")
        style.lighten(axes)
    panels[0].set_ylabel(f"stiffness K ({unit_of('stiffness', experiment.rig.motion)})")
    if theory:
        panels[0].plot([], [], color="#333333", **_THEORY, label="linear theory, no friction")
    explain(panels[0], [boundary for boundary in found.boundaries if boundary.criterion in criteria])
    style.key_below(figure, panels[0])
    title = f"Largest stable K of {experiment.rig.name}" if alone else f"Z-width of {experiment.rig.name}"
    figure.suptitle(f"{title}, {_describe_hits(found)}", fontsize=11)
    return figure


@style.own_style()
def kmax_figure(found: KMax, *, theory: Curve | None = None, paper: Mapping[str, Curve] | None = None) -> Any:
    """Return the figure of the largest stable stiffness of an undamped wall over the sampling rate (Hz).

    `theory` is such a curve by linear theory, and `paper` contains such curves of papers, by name.
    """
    experiment = found.map.plan.experiment
    figure = style.new_figure(7.0, 4.6)
    axes = figure.subplots()
    for number, criterion in enumerate(("felt", "heard")):
        colour = style.SERIES[number]
        curve = found.curve(criterion)
        # Equal curves remain visible under each other: widths differ.
        label, width = f"stable and not {criterion}", (4.5, 1.2)[number]
        draw_boundaries(axes, found.rates, curve, colour, label, width=width)
    if theory is not None:
        axes.plot(*theory, color="#333333", marker="_", **_THEORY, label="linear theory, no friction")
    for name, points in (paper or {}).items():
        axes.plot(*points, "k*", markersize=11, label=name)
    axes.set_xscale("log")
    _from_zero(axes, found.map, float(axes.dataLim.y1))
    axes.set_xlabel("sampling rate 1/T1 (Hz)")
    style.tidy(axes, f"largest stiffness at B = 0 ({unit_of('stiffness', experiment.rig.motion)})")
    explain(axes, [b for b in found.map.boundaries if b.criterion != "any"])
    style.key_below(figure, axes)
    axes.set_title(f"{experiment.rig.name}, {_describe_hits(found.map)}", fontsize=11)
    return figure


def draw_boundaries(
    axes: Any,
    along: Sequence[float],
    curve: Sequence[Boundary],
    colour: str,
    label: str,
    *,
    width: float = 1.6,
) -> None:
    """Draw stability limits at the positions `along`: mean, band between extremes, and symbols of special cases.

    These are a limit that the search did not reach, no stable wall, a wall whose damping is not rendered, and islands.
    """
    size = 2.0 + 1.2 * width
    # A damping without a stable wall breaks the line.
    limits = [boundary.stiffness if boundary.stiffness > 0.0 else math.nan for boundary in curve]
    axes.plot(along, limits, "o-", color=colour, linewidth=width, markersize=size, label=label)
    lowest, highest = [boundary.lowest for boundary in curve], [boundary.highest for boundary in curve]
    axes.fill_between(along, lowest, highest, color=colour, **_BAND)
    if len(curve) == 1:  # a band has no width there
        axes.vlines(along, lowest, highest, color=colour, linewidth=width)
    capped = [
        (position, boundary.stiffness)
        for position, boundary in zip(along, curve, strict=True)
        if boundary.capped
    ]
    if capped:
        axes.plot(*zip(*capped, strict=True), color=colour, **_CAP)
    failed = [position for position, boundary in zip(along, curve, strict=True) if boundary.stiffness <= 0.0]
    if failed:
        axes.plot(failed, [0.0] * len(failed), color=colour, **_HOLE)
    for position, boundary in zip(along, curve, strict=True):
        if boundary.rendered < RENDERED:
            axes.plot([position], [boundary.stiffness], color=colour, **_NOT_RENDERED)
        for limit in boundary.limits:
            for low, high in limit.islands:
                axes.plot([position, position], [low, high], color=colour, **_ISLAND)


def _from_zero(axes: Any, found: ZWidth, highest: float) -> None:
    """Set the axis of stiffness from 0 to above `highest`, or to the softest tested wall if `highest` is 0."""
    top = 1.08 * highest or found.plan.search.lowest
    axes.set_ylim(-0.02 * top, top)


def explain(axes: Any, boundaries: Sequence[Boundary]) -> None:
    """Add legend entries for the symbols that occur in `boundaries`: band, missing upper limit, islands and others."""
    if any(boundary.lowest < boundary.highest for boundary in boundaries):
        axes.fill_between([], [], [], color="#333333", **_BAND, label="from the lowest limit to the highest")
    if any(boundary.capped for boundary in boundaries):
        axes.plot([], [], color="#333333", **_CAP, label="no wall failed: the limit lies above")
    if any(boundary.stiffness <= 0.0 for boundary in boundaries):
        axes.plot([], [], color="#333333", **_HOLE, label="no wall passed, from the softest one on")
    if any(boundary.rendered < RENDERED for boundary in boundaries):
        axes.plot(
            [], [], color="#333333", **_NOT_RENDERED, label="damping not rendered: counts towards no width"
        )
    if any(limit.islands for boundary in boundaries for limit in boundary.limits):
        axes.plot([], [], color="#333333", **_ISLAND, label="island: stable walls beyond the limit")


def _describe_hits(found: ZWidth) -> str:
    trial, plan = found.plan.experiment.trial, found.plan
    push = (
        f"in a {found.plan.experiment.operator.grip} hand"
        if trial.kind == "human"
        else f"pushed by {trial.effort:g} {unit_of('effort', plan.experiment.rig.motion)}"
    )
    offsets, repeats = (
        f"{n} {name}{'' if n == 1 else 's'}"
        for n, name in ((len(plan.offsets), "offset"), (plan.repeats, "repeat"))
    )
    by = ", judged by the simulation's truth" if plan.judged == "true" else ""
    return f"{push}; {offsets} × {repeats}, {plan.search.way}{by}"
