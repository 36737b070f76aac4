"""Data that no fit should be made of: each refusal says what is wrong with them and what to do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rig.analysis.impedance.estimate import periodic
from rig.analysis.impedance.signals import ExcitedRun
from rig.core.errors import RigError

Floats = NDArray[np.float64]

LEAST_COHERENCE = 0.8  # of the median line
LEAST_MOTION_COUNTS = 5.0  # rms
MOST_DRIFT = 0.2  # change from period to period, of the speed at the lines
LARGEST_UNEXPLAINED = 0.1  # share of the velocity, rms over the lines, that a fit leaves

_LOWER_BAND = (
    "if the highest lines move the handle by less than a count, end the band lower (a rate of 1 kHz ends it at 150 Hz) "
    "or allow more effort (rig.limits.effort)"
)


class IdentificationError(RigError):
    """The data do not say what the rig is; the message says why, the remedy what to measure instead."""

    exit_code = 12


def coherence(runs: Sequence[ExcitedRun]) -> Floats:
    """γ² of motion and excitation at each line, over all periods of all realisations (`impedance.estimate`)."""
    return periodic(runs).coherence_motion


def check_excited(runs: Sequence[ExcitedRun], resolution: float) -> Floats:
    """Refuse excited motion that is too small, drifts or does not follow the excitation; return its coherence.

    Raises
    ------
    IdentificationError
        With the numbers and a remedy.
    """
    if len(runs) < 2:
        raise IdentificationError(
            "one realisation has no coherence and no interval", remedy="use two or more, six are usual"
        )
    for run in runs:
        _check_motion(run, resolution)
    found = coherence(runs)
    median = float(np.median(found))
    if not median >= LEAST_COHERENCE:
        worst = runs[0].lines_hz[int(np.argmin(found))]
        raise IdentificationError(
            f"the motion does not follow the excitation: the coherence of the median line is {median:.2f}, "
            f"{LEAST_COHERENCE:g} is the least (worst at {worst:.4g} Hz)",
            remedy="increase the excitation, keep hands off the handle, and look for what else moves it",
        )
    return found


def check_explained(unexplained: float) -> None:
    """Refuse a fit that leaves too much of the motion (share, rms) unexplained."""
    if not unexplained <= LARGEST_UNEXPLAINED:
        raise IdentificationError(
            f"the model leaves {100 * unexplained:.0f} % of the motion unexplained, "
            f"{100 * LARGEST_UNEXPLAINED:.0f} % is the most",
            remedy=f"{_LOWER_BAND}; a second mode, backlash or a loose part needs a band that ends below it, too",
        )


def _check_motion(run: ExcitedRun, resolution: float) -> None:
    motion = run.level_position()
    rms = float(motion.std())
    if rms < LEAST_MOTION_COUNTS * resolution:
        raise IdentificationError(
            f"the handle moved {rms / resolution:.1f} counts rms, {LEAST_MOTION_COUNTS:g} are the least",
            remedy="increase the excitation: friction holds the handle, or the motor is not connected",
        )
    if run.periods > 1:
        by_period = motion.reshape(run.periods, run.period_samples)
        speed = run.bins * np.fft.rfft(by_period, axis=1)[:, run.bins]
        change = float(np.linalg.norm(np.diff(speed, axis=0)) / np.linalg.norm(speed[1:]))
        if change > MOST_DRIFT:
            raise IdentificationError(
                f"the speed at the lines changes by {100 * change:.0f} % from one period to the next, "
                f"{100 * MOST_DRIFT:.0f} % is the most",
                remedy=f"keep hands off the handle; {_LOWER_BAND}",
            )
