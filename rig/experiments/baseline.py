"""What a rig shows while nobody touches the wall: the free space at the beginning of a person's trial."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig.config import Experiment
from rig.core.sample import Phase
from rig.recording.data import Recording


@dataclass(frozen=True, slots=True, kw_only=True)
class Baseline:
    """Free space before a hit, as it was recorded; velocities and efforts in the units of the rig.

    Attributes
    ----------
    duration_s
        How much of it there is (s): less than ``trial.baseline_s`` where the run ended in it.
    velocity_rms
        Of the estimated velocity (rad/s or m/s).
    effort_rms
        Of the effort of the measured current (N·m or N): noise and offset of the sensor, where none is sent.
    sent_rms
        Of the effort that was sent (N·m or N): 0 unless the wall was touched or friction is compensated.
    count_range
        How many counts the encoder went through.
    touched
        Whether the wall was touched, which makes the trial invalid.
    """

    duration_s: float
    velocity_rms: float
    effort_rms: float
    sent_rms: float
    count_range: int
    touched: bool


def baseline(recording: Recording, experiment: Experiment) -> Baseline | None:
    """Measure the baseline of a recording of this experiment; None where the trial has none or never began."""
    tick_s = 1.0 / experiment.controller.position_rate
    ticks = round(experiment.trial.baseline_s / tick_s)
    trial = recording.rows[recording.rows["phase"] == Phase.TRIAL]
    if ticks == 0 or len(trial) == 0:
        return None
    place = np.cumsum(trial["elapsed_ticks"]) - trial["elapsed_ticks"][0]  # a gap's ticks passed too
    rows = trial[place < ticks]
    amplifier = experiment.rig.amplifier
    return Baseline(
        duration_s=float(min(ticks, place[len(rows) - 1] + 1) * tick_s),
        velocity_rms=_rms(rows["velocity"]),
        effort_rms=_rms(amplifier.effort_per_ampere * rows["current_measured"]),
        sent_rms=_rms(rows["effort_sent"]),
        count_range=int(np.ptp(rows["count"])),
        touched=bool((rows["penetration"] > 0.0).any()),
    )


def _rms(values: np.typing.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
