"""Draw the identification of a rig's parameters: pushes, friction over velocity, response to excitation, with fits.

``rig/views/table.json`` registers it. It must not fit anything.
"""

from typing import Any

import numpy as np

from rig.analysis.identification import CoggingMap
from rig.core.sample import Motion, unit_of
from rig.experiments.identification.identify import Identification, trial_rows
from rig.recording.reader import open_recording
from rig.views.plots import style


@style.own_style()
def identification_figure(found: Identification) -> Any:
    """Return the matplotlib figure with the data, fits and residuals from the identification of a rig's parameters."""
    has_cogging = found.cogging is not None
    figure = style.new_figure(12.0, 11.5 if has_cogging else 8.5)
    rows = figure.subplots(3 + has_cogging, 2, height_ratios=(3, 3, 2, 3)[: 3 + has_cogging])
    (pushes, response), (sliding, phase), (sliding_residual, response_residual) = rows[:3]
    if found.cogging is not None:
        _draw_cogging(rows[3], found.cogging, found.experiment.rig.motion)
    _draw_pushes(pushes, found)
    _draw_sliding(sliding, sliding_residual, found)
    _draw_response(response, phase, response_residual, found)
    experiment = found.experiment
    figure.suptitle(f"{experiment.rig.name}: identification, lines are fits", fontsize=12)
    return figure


def _draw_pushes(axes: Any, found: Identification) -> None:
    experiment = found.experiment
    recording = open_recording(found.recordings["signs"][0])
    rows = trial_rows(recording)
    rate = recording.experiment["controller"]["position_rate"]
    time_s = np.arange(len(rows)) / rate
    pushed = np.flatnonzero(rows["effort_sent"])
    end = min(len(rows), int(pushed[-1]) + rate // 5) if len(pushed) else len(rows)
    axes.plot(time_s[:end], rows["position"][:end], color=style.MEASURED, linewidth=1.0)
    style.tidy(axes, f"position ({unit_of('position', experiment.rig.motion)})")
    effort = axes.twinx()
    effort.plot(time_s[:end], rows["effort_sent"][:end], color=style.SENT, linewidth=0.8)
    effort.set_ylabel(f"effort ({unit_of('effort', experiment.rig.motion)})", color=style.SENT)
    effort.spines["top"].set_visible(False)
    axes.set_xlabel("time (s)")
    axes.set_title("pushes", fontsize=11)


def _draw_cogging(both: Any, fit: CoggingMap, motion: Motion) -> None:
    cogging, friction = both
    at = np.linspace(fit.minimum, fit.maximum, 1000)
    effort, position = unit_of("effort", motion), unit_of("position", motion)
    cogging.plot(fit.position, fit.effort, ".", color=style.MEASURED, markersize=3)
    cogging.plot(at, fit.cogging.effort(at), color=style.SENT, linewidth=1.0)
    cogging.set_title("cogging: half the sum of both ways", fontsize=11)
    friction.plot(fit.position, fit.rubbing, ".", color=style.MEASURED, markersize=3)
    friction.axhline(fit.friction.value, color=style.SENT, linewidth=1.0)
    friction.set_title("friction: half the difference", fontsize=11)
    for axes in (cogging, friction):
        style.tidy(axes, f"effort ({effort})")
        axes.set_xlabel(f"position ({position})")


def _draw_sliding(axes: Any, left: Any, found: Identification) -> None:
    experiment, fit = found.experiment, found.sliding
    speed = np.geomspace(1e-3, 1.05, 60) * float(np.abs(fit.velocity).max())
    for velocity in (speed, -speed):
        axes.plot(velocity, fit.at(velocity), color=style.SENT, linewidth=1.2)
    axes.plot(fit.velocity, fit.effort, "o", color=style.MEASURED, markersize=4)
    style.tidy(axes, f"effort ({unit_of('effort', experiment.rig.motion)})")
    axes.set_title("friction while sliding", fontsize=11)
    left.plot(fit.velocity, fit.effort - fit.at(fit.velocity), "o", color=style.MEASURED, markersize=4)
    # The fit itself: residuals are the distances from it.
    left.axhline(0.0, color=style.SENT, linewidth=1.0)
    style.tidy(left, f"residual ({unit_of('effort', experiment.rig.motion)})")
    left.set_xlabel(f"velocity ({unit_of('velocity', experiment.rig.motion)})")


def _draw_response(response: Any, phase: Any, residual: Any, found: Identification) -> None:
    x, fit = found.experiment, found.dynamics
    lines, scale = fit.lines_hz, (2.0 * np.pi * fit.lines_hz) ** 2
    acceleration = f"{unit_of('acceleration', x.rig.motion)} per {unit_of('effort', x.rig.motion)}"
    response.loglog(lines, np.abs(fit.fitted) * scale, color=style.SENT, linewidth=1.2)
    response.errorbar(
        lines,
        np.abs(fit.measured) * scale,
        2.0 * fit.deviation * scale,
        fmt="o",
        color=style.MEASURED,
        markersize=3,
        elinewidth=0.7,
    )
    style.tidy(response, f"acceleration over effort ({acceleration})")
    response.set_title("excited, friction removed (bars: 2 deviations of one realisation)", fontsize=11)
    phase.semilogx(lines, _degrees(-fit.fitted), color=style.SENT, linewidth=1.2)
    phase.semilogx(lines, _degrees(-fit.measured), "o", color=style.MEASURED, markersize=3)
    style.tidy(phase, "phase (°)")
    share = np.abs(fit.measured - fit.fitted) / np.abs(fit.fitted)
    residual.loglog(lines, 100.0 * share, "o", color=style.MEASURED, markersize=3)
    residual.loglog(lines, 100.0 * fit.deviation / np.abs(fit.fitted), color=style.WALL, linewidth=1.0)
    style.tidy(residual, "residual (%)")
    residual.set_xlabel("frequency (Hz); grey: scatter of one realisation")


def _degrees(values: Any) -> Any:
    return np.degrees(np.unwrap(np.angle(values)))
