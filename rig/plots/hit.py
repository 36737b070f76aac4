"""The picture of a hit: position against the wall, velocity, and effort, on one time axis that starts at contact."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.plots import style
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from rig.sample import Phase, RowFlag, unit_of

BEFORE_CONTACT_S = 0.05
_VERDICT_COLOUR = {"stable": "#00703c", "limit cycle": "#b35900", "unstable": "#b00020", "invalid": "#666666"}


def draw_hit(path: str | Path, picture: str | Path | None = None) -> Path:
    """Draw a recording.

    Parameters
    ----------
    path
        The recording.
    picture
        PNG to write; beside the recording unless given.

    Returns
    -------
    Path
        The picture.
    """
    recording = open_recording(path)
    target = Path(picture) if picture else Path(path).with_suffix(".png")
    return style.save(hit_figure(recording), target)


def hit_figure(recording: Recording) -> Any:
    """Return the figure of a recording (`matplotlib.figure.Figure`)."""
    rows, motion = recording.rows, recording.header["motion"]
    units = {q: unit_of(q, motion) for q in ("position", "velocity", "effort", "stiffness", "damping")}
    wall = recording.experiment["wall"]
    time_s, shown = _window(rows, recording.time_s)
    rows, time_s = rows[shown], time_s[shown]
    scale, prefix = (1e3, "m") if len(rows) and np.ptp(rows["position"]) < 0.5 else (1.0, "")

    figure = style.new_figure()
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 3))
    _shade_wall(top, rows, wall, scale)
    top.plot(time_s, scale * rows["position"], color=style.MEASURED, linewidth=1.2, label="measured")
    if recording.has_truth:
        top.plot(
            time_s,
            scale * rows["handle_position_true"],
            color=style.TRUE,
            linewidth=0.9,
            label="handle, true",
        )
        middle.plot(time_s, rows["velocity_true"], color=style.TRUE, linewidth=0.9, label="true")
    middle.plot(time_s, rows["velocity"], color=style.MEASURED, linewidth=1.0, label="estimated")
    bottom.plot(time_s, rows["effort_sent"], color=style.SENT, linewidth=0.9, label="sent")
    bottom.plot(
        time_s, -wall["side"] * rows["effort_wall"], color=style.OTHER, linewidth=0.7, label="of the wall"
    )
    limit = recording.experiment["rig"]["limits"]["effort"]
    saturated = (rows["flags"] & int(RowFlag.SATURATED)) != 0
    if saturated.any():
        bottom.plot(
            time_s[saturated], rows["effort_sent"][saturated], "x", color="#b00020", label=f"at ±{limit:g}"
        )
    style.tidy(top, f"position ({prefix}{units['position']})")
    style.tidy(middle, f"velocity ({units['velocity']})")
    style.tidy(bottom, f"effort ({units['effort']})")
    for axes in (top, middle, bottom):
        axes.legend(loc="upper right", frameon=False, fontsize=8, ncols=3)
    bottom.set_xlabel("time from first contact (s)")
    _title(figure, recording, units)
    return figure


def _window(rows: NDArray[np.void], time_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], slice]:
    """Time from first contact, and the rows from shortly before it to the end of the push (or all rows)."""
    trial = rows["phase"] == Phase.TRIAL
    contact = np.flatnonzero(trial & (rows["penetration"] > 0.0))
    if not len(contact):
        return time_s, slice(None)
    zero = time_s[contact[0]]
    first = int(np.searchsorted(time_s, zero - BEFORE_CONTACT_S))
    last = int(np.flatnonzero(trial)[-1]) + 1
    return time_s - zero, slice(first, last)


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


def _title(figure: Any, recording: Recording, units: dict[str, str]) -> None:
    wall, rates = recording.experiment["wall"], recording.experiment["controller"]
    scheme = "uniform" if rates["position_rate"] == rates["velocity_rate"] else "dual-rate"
    verdict = (recording.trailer or {}).get("verdict")
    kind = verdict["kind"] if verdict else (recording.trailer or {}).get("reason", "not finished")
    text = (
        f"{recording.header['rig']}: {kind}\n"
        f"K = {wall['stiffness']:g} {units['stiffness']}, B = {wall['damping']:g} {units['damping']}; "
        f"{scheme} {rates['position_rate'] / 1e3:g}/{rates['velocity_rate'] / 1e3:g} kHz, {rates['estimator']}"
    )
    figure.suptitle(text, fontsize=11, color=_VERDICT_COLOUR.get(kind, "#333333"))
