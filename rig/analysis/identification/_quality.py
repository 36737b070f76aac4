"""Reject data that are too poor for a fit, with a message that says what is wrong and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from rig.analysis.impedance._estimate import periodic
from rig.analysis.impedance._signals import ExcitedRun
from rig.core.errors import RigError

Floats = NDArray[np.float64]

# Lowest coherence of a fitted line: the signal has twice the amplitude of its noise.
LEAST_COHERENCE = 0.8
# The median of so many lines ends the band, so that three lines in a notch do not end it.
NEAR_LINES = 7
# Longest gap in a band: about an octave.
BRIDGED_LINES = 16
# Fewest lines of a fit: mass, damping and delay of a rigid body, and enough more to detect a misfit.
LEAST_LINES = 12
# Rms; below it the handle stands still. Of 169 simulated identifications (presets, a paddle and 54 random rigs, with
# encoders down to a 64th; 2026-11-29) 38 moved by 1 to 5 counts: the interval held the inertia in 35, 1.5 times the
# interval in all; the worst was off by 7 %, at 1.2 counts. A least of 5 would refuse them all.
LEAST_MOTION_COUNTS = 1.0
# Change from period to period, at the median line. Of 368 simulated runs without a disturbance 5 changed by more than
# 0.2, none by more than 0.4. With one (a hand that takes hold, bumps, late commands; 600 runs) 39 fits lay from 0.2 to
# 0.4: 1.5 times the interval held the inertia in all, the worst was off by 12 %. So from 0.2 on a result has a warning.
# Beyond 0.4 a hand makes errors of 36 %, with intervals as wide.
DOUBTFUL_DRIFT, MOST_DRIFT = 0.2, 0.4
LARGEST_UNEXPLAINED = 0.1  # share of the velocity, rms over the lines, that a fit leaves


class IdentificationError(RigError):
    """The data are too poor to identify the rig; the message states the reason, and what to change."""

    exit_code = 12


@dataclass(frozen=True, slots=True)
class Band:
    """A range of neighbouring excited frequencies (spectral lines) in which the motion is coherent with the excitation.

    Attributes
    ----------
    first, lines
        Index of the band's lowest line among the excited lines, and number of lines in the band.
    low_hz, high_hz
        Frequency of the lowest and of the highest line (Hz).
    below, above
        Reason why lines below or above the band are left out; empty if no line is left out.
    """

    first: int
    lines: int
    low_hz: float
    high_hz: float
    below: str = ""
    above: str = ""

    @property
    def chosen(self) -> slice:
        """Return the slice that selects this frequency band from an array over all excited frequencies."""
        return slice(self.first, self.first + self.lines)

    @property
    def text(self) -> str:
        """Return the ends of a band of frequencies (Hz), its number of spectral lines and why it ends, as text."""
        why = [f"; {side}: {text}" for side, text in (("below", self.below), ("above", self.above)) if text]
        return f"{self.low_hz:.4g} to {self.high_hz:.4g} Hz, {self.lines} lines{''.join(why) or ', all excited ones'}"

    def shorter(self, lines_hz: Floats, lines: int, why: str) -> Band:
        """Return this band cut to its lowest `lines` of all excited `lines_hz` (Hz), with the reason `why`."""
        return replace(self, lines=lines, high_hz=float(lines_hz[self.first + lines - 1]), above=why)


def coherence(runs: Sequence[ExcitedRun]) -> Floats:
    """Return the coherence γ² of velocity and excitation at each excited frequency, over all periods of all runs."""
    return periodic(runs).coherence_motion


def find_band(lines_hz: Floats, found: Floats) -> Band:
    """Return the lowest range of the frequencies `lines_hz` (Hz) in which the coherence `found` suffices for a fit."""
    reach = min(NEAR_LINES, len(found)) // 2
    near = sliding_window_view(np.pad(np.nan_to_num(found), reach, mode="edge"), 2 * reach + 1)
    smooth = np.median(near, axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], smooth >= LEAST_COHERENCE, [0]])))
    rows = [row for row in edges.reshape(-1, 2).tolist() if row[1] - row[0] >= LEAST_LINES]
    if not rows:
        return Band(first=0, lines=0, low_hz=float(lines_hz[0]), high_hz=float(lines_hz[0]))
    first, end = rows[0]
    # A gap, such as an anti-resonance in which the handle stands still, does not end the band if enough lines follow:
    # the fit weights lines in the gap by their scatter.
    for begin, later in rows[1:]:
        if begin - end <= BRIDGED_LINES:
            end = later

    def why(place: int) -> str:
        return (
            f"coherence {smooth[place]:.2f} at {lines_hz[place]:.4g} Hz, at least {LEAST_COHERENCE:g} "
            "is needed"
        )

    return Band(
        first=first,
        lines=end - first,
        low_hz=float(lines_hz[first]),
        high_hz=float(lines_hz[end - 1]),
        below=why(first - 1) if first else "",
        above=why(end) if end < len(found) else "",
    )


def check_excited(runs: Sequence[ExcitedRun], resolution: float) -> tuple[Band, Floats]:
    """Reject motion that is too small, drifts or does not follow the excitation.

    Return the frequency band for a fit, and the coherence at all excited frequencies. `resolution` is the travel for
    one count (rad or m).

    Raises
    ------
    IdentificationError
        The motion is rejected, or there are fewer than two realisations (runs with other random phases).
    """
    if len(runs) < 2:
        raise IdentificationError(
            f"number of realisations: {len(runs)}; coherence and confidence intervals need at least two",
            remedy="measure two or more realisations; six are usual",
        )
    for run in runs:
        _check_size(run, resolution)
    found = coherence(runs)
    band = find_band(runs[0].lines_hz, found)
    if band.lines < LEAST_LINES:
        coherent = int(np.sum(found >= LEAST_COHERENCE))
        raise IdentificationError(
            f"the motion does not follow the excitation: {coherent} of {len(found)} frequencies have a "
            f"coherence of {LEAST_COHERENCE:g} or more (median {np.median(found):.2f}); at least "
            f"{LEAST_LINES} neighbouring ones are needed",
            remedy="keep hands off the handle, allow more effort (rig.limits.effort) or speed "
            "(rig.limits.speed), or use an encoder with more counts",
        )
    for run in runs:
        _check_drift(run, band)
    return band, found


def check_explained(unexplained: float) -> None:
    """Raise `IdentificationError` if a fit leaves too large a share (0 to 1) of the rms velocity unexplained."""
    if not unexplained <= LARGEST_UNEXPLAINED:
        raise IdentificationError(
            f"the model leaves {100 * unexplained:.0f} % of the motion unexplained; at most "
            f"{100 * LARGEST_UNEXPLAINED:.0f} % are allowed",
            remedy="check for a second mode, backlash or a loose part: the model does not fit a "
            "narrower band either",
        )


def _check_size(run: ExcitedRun, resolution: float) -> None:
    rms = float(run.level_position().std())
    if rms < LEAST_MOTION_COUNTS * resolution:
        raise IdentificationError(
            f"the handle moved {rms / resolution:.1f} counts rms; at least {LEAST_MOTION_COUNTS:g} "
            "are needed",
            remedy="increase the excitation, or use an encoder with more counts; if this does not help, "
            "friction holds the handle, or the motor is not connected",
        )


def period_change(run: ExcitedRun, lines: slice = slice(None)) -> float:
    """Return the relative change of the motion from period to period: median over periods and excited `lines`."""
    if run.periods < 2:
        return 0.0
    by_period = run.level_position().reshape(run.periods, run.period_samples)
    at_lines = np.fft.rfft(by_period, axis=1)[:, run.bins[lines]]
    return float(np.median(np.abs(np.diff(at_lines, axis=0)) / np.abs(at_lines[1:])))


def _check_drift(run: ExcitedRun, band: Band) -> None:
    change = period_change(run, band.chosen)
    if change > MOST_DRIFT:
        raise IdentificationError(
            f"the motion at the median excited frequency changes by {100 * change:.0f} % from one period to the "
            f"next; at most {100 * MOST_DRIFT:.0f} % are allowed",
            remedy="keep hands off the handle, and allow more effort (rig.limits.effort)",
        )
