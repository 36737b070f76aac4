"""Draw a wall hit: position and wall, velocity, and effort, on one time axis that starts at the first contact.

``rig/views/table.json``, `rig recording show`, the console and the drawing process of `rig hit` call it. It must not
write to a recording.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core import program
from rig.core.sample import Phase, RowFlag, phase_name, unit_of
from rig.recording.data import Recording
from rig.recording.origin import counts_facts
from rig.recording.reader import open_recording
from rig.views.plots import style
from rig.views.plots.column import column_figure

DRAWN = (  # columns that the figure takes
    "phase",
    "device_time",
    "received_at",
    "flags",
    "penetration",
    "position",
    "velocity",
    "effort_wall",
    "effort_sent",
    "position_true",
    "handle_position_true",
    "handle_velocity_true",
)
BEFORE_CONTACT_S = 0.02
SHORTEST_IMPACT_S, LONGEST_IMPACT_S = 0.05, 0.2


def draw_hit(path: str | Path, picture: str | Path | None = None) -> Path:
    """Draw the recording of a wall hit into a file, and return the picture's path.

    The ending of `picture` selects the format; by default it is a file beside the recording `path`.
    """
    recording = open_recording(path, DRAWN)
    target = Path(picture) if picture else Path(path).with_suffix(".png")
    return style.save(hit_figure(recording), target)


def main() -> None:
    """Run the drawing process of `rig hit`: draw a picture for each line of JSON, and reply with a line of JSON."""
    program.begin()
    for line in sys.stdin:
        try:
            answer = {"picture": str(draw_hit(*json.loads(line)))}
        except Exception as error:
            answer = {"error": str(error)}
        print(json.dumps(answer), flush=True)


@style.own_style()
def hit_figure(recording: Recording) -> Any:
    """Return the matplotlib figure of a wall hit: impact on the left, whole push on the right.

    For a recording of imported counts, which has no wall, the figure shows the position over time.
    """
    if counts_facts(recording) is not None:
        return column_figure(recording["position"])
    rows, time_s = _trial(recording)
    hit = len(_contact(recording)) > 0
    figure = style.new_figure(width=11.0)
    grid = figure.subplots(3, 2, sharey="row", height_ratios=(3, 2, 3), width_ratios=(1, 1), squeeze=False)
    for column, until_s in enumerate((_impact_end(recording, time_s), None)):
        shown = slice(None) if until_s is None else slice(0, max(2, int(np.searchsorted(time_s, until_s))))
        _draw_column(grid[:, column], recording, rows[shown], time_s[shown], _scale(rows))
        grid[2, column].set_xlabel("time from first contact (s)" if hit else "time (s)")
    whole = f"whole run: no contact, it ended in {_last_phase(recording)}"
    grid[0, 0].set_title("impact" if hit else "beginning", fontsize=9)
    grid[0, 1].set_title("whole push" if hit else whole, fontsize=9)
    for axes, place in zip(grid[:, 1], ("lower right", "upper right", "lower right"), strict=True):
        axes.legend(loc=place, framealpha=0.85, edgecolor="none", fontsize=8, ncols=2)
    _label(grid[:, 0], recording, rows)
    _title(figure, recording)
    return figure


@style.own_style()
def xy_figure(recording: Recording) -> Any:
    """Return the figure of the wall's force over penetration, as a force gauge at the handle would measure it.

    An ideal spring gives the straight line K·x. The area of a loop is the energy that the wall takes out of the handle
    (clockwise) or gives to it (counter-clockwise), because of damping, delay and the velocity held between its samples.
    """
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
        style.say(axes, "the handle never was inside the wall")
        return figure
    deepest = float(np.max(penetration))
    shown = style.visible(penetration, force)
    axes.plot(penetration[shown], force[shown], color=style.OTHER, linewidth=0.7, label="rendered")
    axes.plot((0.0, deepest), (0.0, wall["stiffness"] * deepest), "--", color=style.WALL, label="K·x")
    axes.legend(loc="upper left", frameon=False, fontsize=8)
    return figure


def _trial(recording: Recording) -> tuple[NDArray[np.void], NDArray[np.float64]]:
    """Return the rows from shortly before the first contact to the end of the push, and their time since contact (s).

    Without contact, return all rows and their time since the recording's start (s).
    """
    rows, time_s = recording.rows, recording.time_s
    contact = _contact(recording)
    if not len(contact):
        return rows, time_s
    trial = rows["phase"] == Phase.TRIAL
    time_s = time_s - time_s[contact[0]]
    shown = slice(int(np.searchsorted(time_s, -BEFORE_CONTACT_S)), int(np.flatnonzero(trial)[-1]) + 1)
    return rows[shown], time_s[shown]


def _contact(recording: Recording) -> NDArray[np.int64]:
    rows = recording.rows
    return np.flatnonzero((rows["phase"] == Phase.TRIAL) & (rows["penetration"] > 0.0))


def _last_phase(recording: Recording) -> str:
    phases = recording.rows["phase"]
    phases = phases[phases != Phase.DONE]
    return phase_name(int(phases[-1])) if len(phases) else "nothing"


def _impact_end(recording: Recording, time_s: NDArray[np.float64]) -> float:
    """Return the end of the impact panel's time axis (s): 1.5 times the settling time, within the panel's limits."""
    verdict = (recording.trailer or {}).get("verdict") or {}
    settling_s = verdict.get("settling_s")
    wanted = LONGEST_IMPACT_S if settling_s is None else 1.5 * settling_s
    last = float(time_s[-1]) if len(time_s) else 0.0
    return min(last, max(SHORTEST_IMPACT_S, min(wanted, LONGEST_IMPACT_S)))


def _draw_column(
    panels: Any, recording: Recording, rows: NDArray[np.void], time_s: NDArray[np.float64], scale: float
) -> None:
    top, middle, bottom = panels
    wall, limit = recording.experiment["wall"], recording.experiment["rig"]["limits"]["effort"]

    def line(axes: Any, values: NDArray[np.float64], color: str, width: float, label: str) -> None:
        shown = style.visible(values)
        axes.plot(time_s[shown], values[shown], color=color, linewidth=width, label=label)

    if recording.has_truth:
        line(top, scale * rows["handle_position_true"], style.TRUE, 0.9, "true, handle")
        line(middle, rows["handle_velocity_true"], style.TRUE, 0.9, "true, handle")
    line(top, scale * rows["position"], style.MEASURED, 1.0, "measured")
    line(middle, rows["velocity"], style.MEASURED, 1.0, "estimated")
    line(bottom, -wall["side"] * rows["effort_wall"], style.OTHER, 0.8, "wall alone")
    line(bottom, rows["effort_sent"], style.SENT, 0.9, "sent: wall and push")
    saturated = (rows["flags"] & int(RowFlag.SATURATED)) != 0
    if saturated.any():
        times, efforts = time_s[saturated], rows["effort_sent"][saturated]
        shown = style.visible(efforts)
        bottom.plot(times[shown], efforts[shown], "x", color=style.BAD, label=f"at ±{limit:g}")
    gaps = time_s[(rows["flags"] & int(RowFlag.GAP)) != 0]
    if len(gaps):
        gaps, low = gaps[style.visible(gaps)], top.get_ylim()[0]
        top.plot(
            gaps, np.full(len(gaps), low), "|", color=style.BAD, label="gap in the samples", clip_on=False
        )
    _shade_wall(top, rows, wall, scale)
    for axes in panels:
        style.lighten(axes)


def _scale(rows: NDArray[np.void]) -> float:
    return 1e3 if len(rows) and np.ptp(rows["position"]) < 0.5 else 1.0


def _label(panels: Any, recording: Recording, rows: NDArray[np.void]) -> None:
    motion = recording.header["motion"]
    prefix = "m" if _scale(rows) != 1.0 else ""
    names = ("position", "velocity", "effort")
    for axes, name, before in zip(panels, names, (prefix, "", ""), strict=True):
        axes.set_ylabel(f"{name} ({before}{unit_of(name, motion)})")


def _shade_wall(axes: Any, rows: NDArray[np.void], wall: dict[str, Any], scale: float) -> None:
    if not len(rows):
        return
    surface = scale * wall["position"]
    low, high = scale * rows["position"].min(), scale * rows["position"].max()
    margin = 0.1 * max(high - low, 1e-12)
    low, high = min(low, surface) - margin, max(high, surface) + margin
    inside = (surface, high) if wall["side"] > 0 else (low, surface)
    axes.axhspan(*inside, color=style.WALL, alpha=0.2, linewidth=0, label="wall")
    axes.axhline(surface, color=style.WALL, linewidth=0.8)
    axes.set_ylim(low, high)


def _title(figure: Any, recording: Recording) -> None:
    wall, rates, motion = (
        recording.experiment["wall"],
        recording.experiment["controller"],
        recording.header["motion"],
    )
    scheme = "uniform" if rates["position_rate"] == rates["velocity_rate"] else "dual-rate"
    trailer = recording.trailer or {}
    verdict = trailer.get("verdict") or {"kind": trailer.get("reason", "not finished"), "reasons": []}
    stiffness, damping = (f"{wall[q]:g} {unit_of(q, motion)}" for q in ("stiffness", "damping"))
    law = f"K = {stiffness}, B = {damping}" if wall["law"] == "spring-damper" else f"law {wall['law']}"
    rate = f"{scheme} {rates['position_rate'] / 1e3:g}/{rates['velocity_rate'] / 1e3:g} kHz"
    kind, because = verdict.get("kind", ""), "".join(f": {why}" for why in verdict.get("reasons", ())[:1])
    text = f"{recording.header['rig']}: {kind}{because}\n{law}; {rate}, {rates['estimator']}"
    figure.suptitle(text, fontsize=11, color=style.KINDS.get(kind, "#333333"))


if __name__ == "__main__":
    main()
