"""Draw the stability limit by theory: largest stable stiffness over damping for each scheme, with passivity limits.

``rig/views/table.json`` registers it. It must not compute a limit.
"""

from typing import Any

import numpy as np

from rig.analysis.theory import SchemeTheory, Theory
from rig.core.sample import unit_of
from rig.views.plots import style

COLOURS = (style.MEASURED, style.SENT, style.OTHER, style.TRUE, "#cc79a7", "#56b4e9")
HEADROOM = 1.15  # above the highest curve
PASSIVE = ("passive below the dashed line", "passive below the dashed line, and only there")
# Width and height of the right panel over the passive range.
CORNER = 1.5


@style.own_style()
def theory_figure(theory: Theory) -> Any:
    """Return the matplotlib figure of the stability and passivity limits of a rig by theory.

    Solid lines are the largest stable stiffness of the linear loop; islands of stability above these lines are shaded.
    The right panel shows the range of damping B in which a wall can be passive: below the dashed lines it is passive,
    with lag and delay; above the dashed lines it is not passive if the rig is rigid.
    """
    figure = style.new_figure(12.0, 6.0)
    whole, corner = figure.subplots(1, 2, width_ratios=(2, 1))
    for i, scheme in enumerate(theory.schemes):
        colour = COLOURS[i % len(COLOURS)]
        for axes in (whole, corner):
            _draw_edge(axes, scheme, colour)
        _draw_islands(whole, scheme, colour)
        _draw_passivity(corner, scheme, colour)
    if theory.damping > 0.0:
        whole.axvline(theory.damping, color=style.WALL, linewidth=1.0, label="B of the experiment")
    whole.set_xlim(left=0.0)
    whole.set_ylim(0.0, HEADROOM * _highest(theory))
    corner.set_xlim(0.0, CORNER * max((_passive_damping(s) for s in theory.schemes), default=1.0) or 1.0)
    corner.set_ylim(0.0, CORNER * max((_passive_stiffness(s) for s in theory.schemes), default=1.0) or 1.0)
    for axes in (whole, corner):
        axes.set_xlabel(f"damping B of the wall ({unit_of('damping', theory.motion)})")
        style.lighten(axes)
    style.tidy(whole, f"stiffness K of the wall ({unit_of('stiffness', theory.motion)})")
    hand = "no hand" if theory.operator == "none" else f"{theory.operator} hand"
    whole.set_title(f"{theory.rig}, {hand}: linear theory, no friction, no quantum", fontsize=11)
    corner.set_title(PASSIVE[theory.structure == "rigid"], fontsize=11)
    whole.legend(loc="upper right", fontsize=8)
    return figure


def _draw_edge(axes: Any, scheme: SchemeTheory, colour: str) -> None:
    dampings = np.array([limit.damping for limit in scheme.curve])
    limits = np.array([limit.stiffness for limit in scheme.curve])
    capped = np.array([limit.capped for limit in scheme.curve])
    shown = np.flatnonzero(limits > 0.0)
    end = min(int(shown[-1]) + 2, len(dampings)) if len(shown) else 0  # down to the axis, and no farther
    axes.plot(dampings[:end], limits[:end], color=colour, linewidth=1.6, label=scheme.label)
    # The scan ended before a wall failed.
    axes.plot(dampings[capped], limits[capped], "^", color=colour, markersize=5)


def _draw_islands(axes: Any, scheme: SchemeTheory, colour: str) -> None:
    dampings = np.array([limit.damping for limit in scheme.curve])
    most = max((len(limit.islands) for limit in scheme.curve), default=0)
    for number in range(most):
        has_island = np.array([len(limit.islands) > number for limit in scheme.curve])
        low = [limit.islands[number].low if len(limit.islands) > number else 0.0 for limit in scheme.curve]
        high = [limit.islands[number].high if len(limit.islands) > number else 0.0 for limit in scheme.curve]
        label = f"island of the {scheme.label.split(',')[0]} wall" if number == 0 else None
        axes.fill_between(
            dampings, low, high, where=has_island, color=colour, alpha=0.25, linewidth=0, label=label
        )


def _draw_passivity(axes: Any, scheme: SchemeTheory, colour: str) -> None:
    axes.plot(*np.array(scheme.passive).T, "--", color=colour, linewidth=1.0)


def _passive_stiffness(scheme: SchemeTheory) -> float:
    return max(stiffness for _, stiffness in scheme.passive)


def _passive_damping(scheme: SchemeTheory) -> float:
    return scheme.passive[-1][0]


def _highest(theory: Theory) -> float:
    limits = [limit for scheme in theory.schemes for limit in scheme.curve]
    top = max((limit.highest for limit in limits if not limit.capped), default=0.0)
    return top or max((limit.stiffness for limit in limits), default=1.0)
