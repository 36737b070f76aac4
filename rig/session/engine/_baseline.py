"""Measure a rig's baseline without contact with the wall: the free space at the start of a person's trial."""

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
        How much of it there is (s).
    velocity_rms
        Rms of the estimated velocity (rad/s or m/s).
    effort_rms
        Rms effort of the measured current (N·m or N): noise and offset of the sensor, where none is sent.
    sent_rms
        Rms of the sent effort (N·m or N): 0, except at the end of homing.
    count_range
        How many counts the encoder went through.
    """

    duration_s: float
    velocity_rms: float
    effort_rms: float
    sent_rms: float
    count_range: int


def baseline(recording: Recording, experiment: Experiment) -> Baseline | None:
    """Measure the free space in a recording of this experiment; None if it contains none of that phase."""
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


def _rms(values: np.typing.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
