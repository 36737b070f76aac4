"""Measure a rig's baseline noise without wall contact, in the free-space phase at the start of a person's trial.

Each recorded trial of a session calls it (`_hits`). It reads the recording only.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.config import Experiment
from rig.core.sample import Phase
from rig.recording.data import Recording


@dataclass(frozen=True, slots=True, kw_only=True)
class Baseline:
    """Values measured in the free-space phase before a hit, as a baseline of the rig's noise.

    Attributes
    ----------
    duration_s
        Duration of the phase (s).
    velocity_rms
        Root mean square of the estimated velocity (rad/s or m/s).
    effort_rms
        Root mean square of the measured current as effort (N·m or N): noise and offset of the sensor.
    sent_rms
        Root mean square of the sent effort (N·m or N): 0, except at the end of homing.
    count_range
        Largest minus smallest encoder count.
    """

    duration_s: float
    velocity_rms: float
    effort_rms: float
    sent_rms: float
    count_range: int


def baseline(recording: Recording, experiment: Experiment) -> Baseline | None:
    """Return the baseline noise in the recording of a trial; None if the recording has no free-space phase."""
    rows = recording.rows[recording.rows["phase"] == Phase.FREE]
    if len(rows) == 0:
        return None
    amplifier = experiment.rig.amplifier
    return Baseline(
        duration_s=float(rows["elapsed_ticks"].sum()) / experiment.controller.position_rate,
        velocity_rms=_rms(rows["velocity"]),
        effort_rms=_rms(amplifier.effort_per_ampere * rows["current_measured"]),
        sent_rms=_rms(rows["effort_sent"]),
        count_range=int(np.ptp(rows["count"])),
    )


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
