"""Draw a replay (a recording recomputed with another estimator): recorded and replayed velocity and effort."""

from typing import Any

from rig.core.sample import unit_of
from rig.experiments.trials.replay import ReplayResult
from rig.views.plots import style


@style.own_style()
def replay_figure(result: ReplayResult) -> Any:
    """Return the matplotlib figure of recorded and replayed velocity and effort over time."""
    recording = result.of
    motion, time_s = recording.header["motion"], recording.time_s
    figure = style.new_figure(height=5.0)
    top, bottom = figure.subplots(2, 1, sharex=True)
    for axes, column, quantity in ((top, "velocity", "velocity"), (bottom, "effort_sent", "effort")):
        axes.plot(time_s, result.recorded[column], color=style.MEASURED, linewidth=0.9, label="recorded")
        axes.plot(
            time_s,
            result.rows[column],
            color=style.SENT,
            linewidth=0.9,
            label=f"replayed: {result.estimator}",
        )
        style.tidy(axes, f"{quantity} ({unit_of(quantity, motion)})")
        axes.legend(loc="upper right", frameon=False, fontsize=8, ncols=2)
    bottom.set_xlabel("time (s)")
    figure.suptitle(f"{recording.header['rig']}, replayed", fontsize=11)
    return figure
