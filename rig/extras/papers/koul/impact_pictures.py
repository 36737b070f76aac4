"""Draw figures 7 and 8 of Koul et al. (impacts, and estimated velocities) from this project's results."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rig.extras.papers.koul.compare import EstimatorProfile, Panel, Profiles
from rig.views.plots import style
from rig.views.plots.compare import draw_penetration

STRETCH = 1.8  # axis range over the largest true speed, to show the noise


@style.own_style()
def draw_figure_7(panels: Sequence[Panel], picture: str | Path, *, offset: int = 1) -> Path:
    """Draw the penetrations of figure 7, with a row for each arithmetic and a column for each rate; return the path.

    `offset` is the index of the encoder offset that is drawn.
    """
    rows = list(dict.fromkeys(panel.arithmetic for panel in panels))
    columns = list(dict.fromkeys(panel.position_rate for panel in panels))
    figure = style.new_figure(width=10.0, height=1.0 + 3.0 * len(rows))
    grid = figure.subplots(len(rows), len(columns), sharex=True, sharey=True, squeeze=False)
    for panel in panels:
        axes = grid[rows.index(panel.arithmetic), columns.index(panel.position_rate)]
        draw_penetration(axes, panel.comparison.outcomes, offset)
        peaks = " / ".join(f"{peak:.3g}" for peak in panel.peaks)
        axes.set_title(
            f"{panel.position_rate / 1e3:g} kHz, {panel.arithmetic}: peaks {peaks} counts", fontsize=9
        )
        axes.legend(loc="lower right", framealpha=0.85, edgecolor="none", fontsize=8)
        axes.set_xlim(0.0, 0.16)
    for axes in grid[-1]:
        axes.set_xlabel("time from first contact (s)")
    return style.save(figure, Path(picture))


@style.own_style()
def draw_figure_8(profiles: Profiles, picture: str | Path) -> Path:
    """Draw the velocities of figure 8, early and late in the impact, a row for each arithmetic; return the path."""
    rows = list(dict.fromkeys(profile.arithmetic for profile in profiles.profiles))
    figure = style.new_figure(width=10.0, height=1.0 + 3.0 * len(rows))
    grid = figure.subplots(len(rows), 2, sharey="col", squeeze=False)
    parts = (("early", profiles.early_s), ("late", profiles.late_s))
    for row, arithmetic in zip(grid, rows, strict=True):
        shown = [profile for profile in profiles.profiles if profile.arithmetic == arithmetic]
        for axes, (name, (begin, end)) in zip(row, parts, strict=True):
            for profile in sorted(shown, key=lambda p: -p.velocity_rate):
                noise = profile.noise_early if name == "early" else profile.noise_late
                axes.plot(profile.time_s, profile.velocity, **_look(profile), label=_label(profile, noise))
            time_s, true = profiles.time_s, profiles.velocity_true
            axes.plot(time_s, true, color=style.WALL, linewidth=2.5, zorder=1, label="true")
            axes.set_xlim(begin, end)
            within = true[(time_s >= begin) & (time_s <= end)]
            largest = STRETCH * float(np.abs(within).max())
            axes.set_ylim(-largest, largest)
            axes.set_title(f"{name}, {arithmetic}", fontsize=9)
            axes.legend(loc="upper right", framealpha=0.85, edgecolor="none", fontsize=8)
            style.tidy(axes, "velocity (rad/s)")
    for axes in grid[-1]:
        axes.set_xlabel("time from first contact (s)")
    return style.save(figure, Path(picture))


def _look(profile: EstimatorProfile) -> dict[str, Any]:
    fast = profile.velocity_rate > 2000
    return {"color": style.SENT if fast else style.MEASURED, "linewidth": 0.8 if fast else 1.2}


def _label(profile: EstimatorProfile, noise: float) -> str:
    return f"{profile.velocity_rate / 1e3:g} kHz: {noise:.2g} rad/s rms off"
