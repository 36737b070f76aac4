"""Pictures of Z-width maps: the limits of every scheme over damping, and the limit over the rate at B = 0.

Solid lines are means over offsets and repeats, bands reach from the lowest to the highest limit. A triangle marks a
limit that is only a cap, bars above a curve are islands, thin dashed lines are the linear theory.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rig.core.sample import unit_of
from rig.experiments.kmax import KMax
from rig.experiments.zwidth import Boundary, ZWidth
from rig.views.plots import style

TITLES = {"felt": "felt", "heard": "heard", "any": "felt, heard or moved"}
Curve = tuple[Sequence[float], Sequence[float]]  # damping or rate, stiffness


def draw_zwidth(
    found: ZWidth,
    picture: str | Path,
    *,
    theory: Mapping[int, Curve] | None = None,
    criteria: Sequence[str] = ("felt", "heard"),
) -> Path:
    """Draw a map, one panel for each criterion; `theory` has curves by number of scheme. Returns the path."""
    experiment = found.plan.experiment
    figure = style.new_figure(4.6 * len(criteria) + 0.6, 4.6)
    panels = figure.subplots(1, len(criteria), sharey=True, squeeze=False)[0]
    for axes, criterion in zip(panels, criteria, strict=True):
        for number, scheme in enumerate(found.plan.schemes):
            colour = style.SERIES[number % len(style.SERIES)]
            curve = found.curve(number, criterion)
            draw_boundaries(axes, [b.damping for b in curve], curve, colour, scheme.label(experiment))
            if theory and number in theory:
                axes.plot(*theory[number], color=colour, linewidth=0.8, linestyle="--")
        axes.set_xlabel(f"damping B ({unit_of('damping', experiment.rig.motion)})")
        axes.set_title(f"stable and not {TITLES[criterion]}", fontsize=10)
        axes.set_ylim(bottom=0.0, top=1.08 * max(b.highest for b in found.boundaries) or 1.0)
        axes.set_xlim(left=0.0)
        style.lighten(axes)
    panels[0].set_ylabel(f"stiffness K ({unit_of('stiffness', experiment.rig.motion)})")
    if theory:
        panels[0].plot(
            [], [], color="#333333", linewidth=0.8, linestyle="--", label="linear theory, no friction"
        )
    panels[0].legend(fontsize=8, loc="upper right")
    figure.suptitle(f"Z-width of {experiment.rig.name}, {_how(found)}", fontsize=11)
    return style.save(figure, Path(picture))


def draw_kmax(
    found: KMax, picture: str | Path, *, theory: Curve | None = None, paper: Mapping[str, Curve] | None = None
) -> Path:
    """Draw the limit at B = 0 over the sampling rate; `paper` has points to compare with, by name."""
    experiment = found.map.plan.experiment
    figure = style.new_figure(7.0, 4.6)
    axes = figure.subplots()
    for number, criterion in enumerate(("felt", "heard")):
        colour = style.SERIES[number]
        draw_boundaries(axes, found.rates, found.curve(criterion), colour, f"stable and not {criterion}")
    if theory is not None:
        axes.plot(*theory, color="#333333", linewidth=0.9, linestyle="--", label="linear theory, no friction")
    for name, points in (paper or {}).items():
        axes.plot(*points, "k*", markersize=11, label=name)
    axes.set_xscale("log")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("sampling rate 1/T1 (Hz)")
    style.tidy(axes, f"largest stiffness at B = 0 ({unit_of('stiffness', experiment.rig.motion)})")
    axes.legend(fontsize=8, loc="upper left")
    axes.set_title(f"{experiment.rig.name}, {_how(found.map)}", fontsize=11)
    return style.save(figure, Path(picture))


def draw_boundaries(
    axes: Any, along: Sequence[float], curve: Sequence[Boundary], colour: str, label: str
) -> None:
    """Draw one curve of limits: mean, band, caps and islands."""
    axes.plot(along, [b.stiffness for b in curve], color=colour, linewidth=1.6, label=label)
    axes.fill_between(
        along, [b.lowest for b in curve], [b.highest for b in curve], color=colour, alpha=0.18, linewidth=0
    )
    capped = [(x, b.stiffness) for x, b in zip(along, curve, strict=True) if b.capped]
    if capped:
        axes.plot(*zip(*capped, strict=True), "^", color=colour, markersize=6)
    for x, boundary in zip(along, curve, strict=True):
        for limit in boundary.limits:
            for low, high in limit.islands:
                axes.plot([x, x], [low, high], color=colour, linewidth=3.0, alpha=0.45, solid_capstyle="butt")


def _how(found: ZWidth) -> str:
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
    return f"{push}; {offsets} × {repeats}, {plan.search.way}"
