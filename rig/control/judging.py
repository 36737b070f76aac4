"""Judge one trial from its signals: the recorded signals, or the true signals of a simulation.

A verdict uses recorded signals only, so that simulated and real trials are judged by the same rules. A simulation can
judge its true signals in addition. All signals contain the trial phase only and are uniformly sampled.

Trials and maps of `rig.experiments` and the simulation use it. It must not open a recording or run a trial.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.faults import LimitFlag
from firmware_protocol.messages import NO_COMMAND_YET
from rig.control._measure import (
    LOST_BITS,
    METER_TYPE,
    NUMBERS,
    NUMBERS_TYPE,
    OVERRULED,
    UNITS,
    Meter,
    MeterArguments,
    measure,
)
from rig.control.verdict import Bools, Floats, Measured, Thresholds, Verdict
from rig.core.sample import Phase, RowFlag

__all__ = [
    "METER_TYPE",
    "NUMBERS",
    "NUMBERS_TYPE",
    "UNITS",
    "Ints",
    "MeterArguments",
    "TrialSignals",
    "judge",
    "measure",
    "measure_signals",
    "meter",
    "recorded_signals",
    "true_signals",
]

Ints = NDArray[np.int64]

# Limit flags of the device that mean another effort than the commanded one; nearing a limit changes none.
_CURRENTS = int(RowFlag.CURRENT_FOLLOWS | RowFlag.CURRENT_DIFFERS | RowFlag.OTHER_CURRENT)
_OVERRULES = int(~(LimitFlag.SPEED | LimitFlag.POSITION))


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialSignals:
    """Signals of one trial, uniformly sampled: arrays of equal length, in SI units.

    If `velocity` is None, it is derived from `position`. `resolution` is the travel for one count, 0 for true signals.
    """

    tick_s: float
    resolution: float
    position: Floats
    velocity: Floats | None
    effort: Floats
    penetration: Floats
    saturated: Bools
    late: Bools
    lost: Ints  # samples lost just before each one; at the last one also what was lost between it and the release
    slew_bound: Bools
    currents: Ints  # marks of `rig.loop._currents`: bits of RowFlag
    overruled: Bools  # the device limited, ramped or withheld what the law commanded


def recorded_signals(
    rows: NDArray[np.void], tick_s: float, resolution: float, *, effort: str = "effort_sent"
) -> TrialSignals:
    """Return the signals of the trial phase from recorded rows (`rig.core.sample.ROW`).

    `effort` names the column of the effort. The default is the effort that the host sent; if a drive rendered the wall
    itself, use ``effort_applied``, which the drive reports. `resolution` is the travel for one count (rad or m).
    """
    trial = rows["phase"] == Phase.TRIAL
    (places,) = np.nonzero(trial)
    lost_before = np.maximum(rows["elapsed_ticks"].astype(np.int64) - 1, 0)
    lost, flags = lost_before[trial], rows["flags"][trial]
    if len(places) and places[-1] + 1 < len(rows):
        # Samples lost between the last tick of the trial and the release.
        lost[-1] += lost_before[places[-1] + 1]

    def flagged(flag: RowFlag) -> Bools:
        return np.asarray((flags & int(flag)) != 0)

    return TrialSignals(
        tick_s=tick_s,
        resolution=abs(resolution),
        position=rows["position"][trial],
        velocity=None,
        effort=rows[effort][trial],
        penetration=rows["penetration"][trial],
        saturated=flagged(RowFlag.SATURATED),
        late=flagged(RowFlag.LATE),
        lost=lost,
        slew_bound=flagged(RowFlag.SLEW_BOUND),
        currents=flags & _CURRENTS,
        overruled=((rows["limits"] & _OVERRULES != 0) | (rows["command_age"] == NO_COMMAND_YET))[trial],
    )


def true_signals(
    rows: NDArray[np.void], recorded: TrialSignals, wall_position: float, wall_side: float
) -> TrialSignals:
    """Return the true signals of a simulated trial from rows that also have `rig.core.sample.TRUTH_COLUMNS`.

    Position and velocity are those of the handle, which the hand feels. Penetration is that of the mass with the
    encoder; in a rig of two masses the capstan lies between handle and encoder. Events and lost samples are copied from
    `recorded`, the recorded signals of the same rows.
    """
    trial = rows["phase"] == Phase.TRIAL
    return replace(
        recorded,
        resolution=0.0,
        position=rows["handle_position_true"][trial],
        velocity=rows["handle_velocity_true"][trial],
        effort=rows["effort_true"][trial],
        penetration=wall_side * (rows["position_true"][trial] - wall_position),
    )


def judge(signals: TrialSignals, thresholds: Thresholds) -> Verdict:
    """Return the verdict on one trial (stable, limit cycle, unstable or invalid), with its reasons and numbers.

    The last part of the trial (`thresholds.tail_s`) decides. A shorter trial is judged on all its samples; a trial
    without samples is invalid.
    """
    return measure_signals(signals, thresholds).verdict


def measure_signals(signals: TrialSignals, thresholds: Thresholds, *, thrown_out: bool = False) -> Measured:
    """Return the numbers by which one trial is judged, in an object that derives the outcome from them.

    `thrown_out` is True if a safety limit ended the run, which the signals do not show.
    """
    numbers = meter(thresholds, signals.tick_s, signals.resolution).recorded(
        signals.position, signals.effort, signals.penetration, _flags(signals), signals.velocity
    )
    return Measured(numbers, thresholds, thrown_out)


def meter(thresholds: Thresholds, tick_s: float, resolution: float) -> Meter:
    """Return an object that computes the numbers by which trials are judged with these thresholds; one for each thread.

    `resolution` is the travel for one count in recorded signals (rad or m).
    """
    return Meter(
        tick_s=tick_s,
        resolution=resolution,
        tail_s=thresholds.tail_s,
        highpass_hz=thresholds.highpass_hz,
        lowpass_hz=thresholds.lowpass_hz,
        felt_velocity=thresholds.felt_velocity,
    )


def _flags(signals: TrialSignals) -> NDArray[np.int64]:
    flags = signals.lost.astype(np.int64) << LOST_BITS | signals.currents
    for bit, marked in (
        (int(RowFlag.SATURATED), signals.saturated),
        (int(RowFlag.LATE), signals.late),
        (int(RowFlag.SLEW_BOUND), signals.slew_bound),
        (OVERRULED, signals.overruled),
    ):
        if marked.any():
            flags |= bit * marked.astype(np.int64)
    return flags
