"""Draw the K–B plane of each scheme: walls that theory and hits judge differently have the colour of the cause."""

from typing import Any

import numpy as np

from rig.analysis.theory import stability_map
from rig.core.sample import unit_of
from rig.extras.papers.disagreement.ablation import (
    CAUSES,
    CONTACT,
    EACH,
    FRICTION,
    NONE,
    OTHERS,
    QUANTUM,
    SATURATION,
)
from rig.extras.papers.disagreement.disagreement import Disagreement, edges_of
from rig.views.plots import style

COLOURS = {
    FRICTION: "#e69f00",
    QUANTUM: "#56b4e9",
    SATURATION: "#cc79a7",
    CONTACT: "#009e73",
    EACH: "#7a5195",
    OTHERS: "#b8860b",
    NONE: "#999999",
}
THEORY: dict[str, Any] = {"color": "#333333", "linewidth": 1.2, "linestyle": "--"}
HITS: dict[str, Any] = {"color": style.MEASURED, "linewidth": 1.0}
POINTS = 60  # of theory's edge along each axis


@style.own_style()
def disagreement_figure(found: Disagreement) -> Any:
    """Return a matplotlib figure with a panel of the K–B plane for each sampling scheme."""
    plan = found.plan
    motion = plan.experiment.rig.motion
    figure = style.new_figure(4.2 * len(plan.schemes) + 0.6, 4.6)
    panels = figure.subplots(1, len(plan.schemes), sharey=True, squeeze=False)[0]
    for number, axes in enumerate(panels):
        _draw_plane(axes, found, number)
        shares = found.shares(number)
        axes.set_title(f"{shares.label}\n{100 * shares.differ.share:.1f} % of the plane differs", fontsize=9)
        axes.set_xlabel(f"damping B ({unit_of('damping', motion)})")
        style.lighten(axes)
    panels[0].set_ylabel(f"stiffness K ({unit_of('stiffness', motion)})")
    there = {wall.cause for wall in found.walls}
    for cause in (cause for cause in CAUSES if cause in there):
        panels[0].fill_between([], [], [], color=COLOURS[cause], linewidth=0.0, label=cause)
    panels[0].plot([], [], **THEORY, label="edge of stability in linear theory")
    panels[0].plot([], [], **HITS, label="edge of the walls that hold")
    style.key_below(figure, panels[0])
    figure.suptitle(f"{plan.experiment.rig.name}: where linear theory and hits differ, and why", fontsize=11)
    return figure


def _draw_plane(axes: Any, found: Disagreement, number: int) -> None:
    plan = found.plan
    damping_edges, stiffness_edges = edges_of(plan.dampings), edges_of(plan.search.rungs, by_ratio=True)
    shape = (len(plan.dampings), len(plan.search.rungs))
    walls = found.of_scheme(number)
    colours = np.array([_rgba(wall.cause) for wall in walls]).reshape(*shape, 4)
    holds = np.array([bool(wall.holds) for wall in walls]).reshape(shape)
    axes.pcolormesh(
        damping_edges, stiffness_edges, colours.transpose(1, 0, 2), linewidth=0.0, rasterized=True
    )
    _draw_edge(axes, damping_edges, stiffness_edges, holds.T)
    dampings, stiffnesses = (
        np.linspace(damping_edges[0], damping_edges[-1], POINTS),
        np.linspace(stiffness_edges[0], stiffness_edges[-1], POINTS),
    )
    radius = stability_map(plan.experiment, plan.schemes[number], stiffnesses, dampings).radius
    look = {"colors": THEORY["color"], "linewidths": THEORY["linewidth"], "linestyles": THEORY["linestyle"]}
    axes.contour(dampings, stiffnesses, radius, levels=[1.0], **look)


def _rgba(cause: str) -> list[float]:
    if not cause:
        return [0.0] * 4
    return [int(COLOURS[cause][place : place + 2], 16) / 255.0 for place in (1, 3, 5)] + [1.0]


def _draw_edge(axes: Any, damping_edges: Any, stiffness_edges: Any, holds: Any) -> None:
    for row, column in zip(*np.nonzero(holds[1:] != holds[:-1]), strict=True):
        axes.plot(damping_edges[column : column + 2], [stiffness_edges[row + 1]] * 2, **HITS)
    for row, column in zip(*np.nonzero(holds[:, 1:] != holds[:, :-1]), strict=True):
        axes.plot([damping_edges[column + 1]] * 2, stiffness_edges[row : row + 2], **HITS)
