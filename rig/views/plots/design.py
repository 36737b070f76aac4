"""Draw what `rig design` found: trade-off between sampling schemes, limits of the recommended and the own scheme."""

from typing import Any

from rig.core.sample import unit_of
from rig.experiments.design import Design, Standing
from rig.views.plots import style
from rig.views.plots.zwidth import draw_boundaries, explain

RECOMMENDED, OWN = style.SENT, style.MEASURED
_SMALLEST, _LARGEST = 20.0, 180.0  # area of a marker (point²)


@style.own_style()
def design_figure(found: Design) -> Any:
    """Return the matplotlib figure of a search for a controller (`rig design`).

    Left: largest stiffness K and range of damping B of each sampling scheme that was simulated. A larger marker means
    more noise at rest; filled markers are schemes of the Pareto front. Right: largest stable K over B, simulated with
    the finest stiffness steps, with a band between the lowest and highest limit over all encoder offsets.
    """
    motion = found.experiment.rig.motion
    stiffness, damping = unit_of("stiffness", motion), unit_of("damping", motion)
    figure = style.new_figure(11.0, 4.8)
    traded, walls = figure.subplots(1, 2)

    front = {one.candidate.key for one in found.front}
    for one in found.standings:
        colour = _colour(found, one)
        face = colour if one.candidate.key in front else "none"
        size = _size(found, one.measures.noise)
        at = one.measures.damping, one.measures.stiffness
        traded.scatter(*at, s=size, facecolors=face, edgecolors=colour, alpha=0.8, zorder=3)
    traded.set_xlabel(f"range of damping B ({damping})")
    style.tidy(traded, f"stiffest wall K ({stiffness})")
    traded.set_title("schemes at the same walls; filled: Pareto front; larger: noisier at rest", fontsize=9)

    shown = [(found.recommended, RECOMMENDED, "recommended: ")]
    if found.recommended is found.own:
        shown = [(found.own, RECOMMENDED, "recommended, the experiment's own: ")]
    else:
        shown.append((found.own, OWN, "the experiment's own: "))
    for one, colour, name in shown:
        along = [boundary.damping for boundary in one.boundary]
        draw_boundaries(walls, along, one.boundary, colour, name + one.label)
    wall = found.wishes.wall
    if wall is not None:
        walls.plot([wall[1]], [wall[0]], "k*", markersize=11, label="wall that must be stable")
    walls.set_xlabel(f"damping B ({damping})")
    style.tidy(walls, f"largest stable K ({stiffness})")
    explain(walls, [boundary for one, _, _ in shown for boundary in one.boundary])
    traded.margins(0.08)
    for axes in (traded, walls):
        axes.set_xlim(left=0.0)
        axes.set_ylim(bottom=0.0)
    style.key_below(figure, walls)
    figure.suptitle(f"Design of {found.experiment.rig.name} for {found.wishes.goal}", fontsize=11)
    return figure


def _colour(found: Design, one: Standing) -> str:
    by_key = {found.own.candidate.key: OWN, found.recommended.candidate.key: RECOMMENDED}
    return by_key.get(one.candidate.key, style.WALL)


def _size(found: Design, noise: float) -> float:
    most = max(one.measures.noise for one in found.standings)
    return _SMALLEST + (_LARGEST - _SMALLEST) * (noise / most) ** 0.5 if most > 0.0 else _SMALLEST
