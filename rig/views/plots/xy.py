"""X-Y: the force of the wall over the penetration, as a force gauge beside the handle would draw it.

An ideal spring is the straight line K·x. What the loop encloses is the energy that the wall takes out of the handle
(run through clockwise) or gives to it (counter-clockwise): damping, delay, and the held velocity.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rig.core.sample import Phase, unit_of
from rig.recording.data import Recording
from rig.views.plots import style

DRAWN = ("phase", "penetration", "effort_wall")  # columns that the figure takes


@style.own_style()
def xy_figure(recording: Recording) -> Any:
    """Return the figure of a recording (`matplotlib.figure.Figure`)."""
    rows, wall, motion = recording.rows, recording.experiment["wall"], recording.header["motion"]
    inside = (rows["phase"] == Phase.TRIAL) & (rows["penetration"] > 0.0)
    penetration, force = rows["penetration"][inside], rows["effort_wall"][inside]
    figure = style.new_figure(width=7.0, height=5.0)
    axes = figure.subplots()
    axes.set_xlabel(f"penetration ({unit_of('position', motion)})")
    style.tidy(axes, f"force of the wall ({unit_of('effort', motion)})")
    figure.suptitle(
        f"{recording.header['rig']}: K = {wall['stiffness']:g} {unit_of('stiffness', motion)}, "
        f"B = {wall['damping']:g} {unit_of('damping', motion)}",
        fontsize=11,
    )
    if not len(penetration):
        style.say(axes, "the handle was never inside the wall")
        return figure
    deepest = float(np.max(penetration))
    shown = style.visible(penetration, force)
    axes.plot(penetration[shown], force[shown], color=style.OTHER, linewidth=0.7, label="rendered")
    axes.plot((0.0, deepest), (0.0, wall["stiffness"] * deepest), "--", color=style.WALL, label="K·x")
    axes.legend(loc="upper left", frameon=False, fontsize=8)
    return figure
