"""Run one motion of a rig with a free handle, as a recorded trial on an open device, and return all its samples.

The torque pulse, the search for the reference, weighing and identification call this module.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.faults import Fault
from rig import config
from rig.analysis.identification import IdentificationError, SignCheck, check_signs
from rig.config import Experiment, controller
from rig.config.controller import LIFETIME_PERIODS, LONGEST_LIFETIME_S, rate_of_lifetime
from rig.core.errors import ConfigError, DeviceFaultError, PlanError, RigError
from rig.core.keyword import Keyword
from rig.core.sample import Phase, RowFlag, unit_of
from rig.devices.framed import FramedDevice
from rig.doctor.gate import LIFETIME_SHARE
from rig.experiments.trials._identify_motions import (
    RATE_STEP,
    REST_S,
    IdentificationMotion,
    coulomb_of,
)
from rig.experiments.trials._trial import TrialRequest, end_of, run_trial
from rig.experiments.trials.preparation import prepared_on
from rig.experiments.trials.settings import RigRequest
from rig.loop.layout import EndReason
from rig.recording.data import Recording

# Largest fraction of late ticks. A late effort acts later, and the recording shows when. In 240 simulated runs with 0.1
# to 20 % late commands (2026-11-29) no fit missed the inertia by more than 1.5 times its interval; of the 73 runs with
# 1 to 5 %, the coherence or the change from period to period refused all but 3.
LATE_SHARE = 0.05
ATTEMPTS = 4  # runs of a motion at one rate while samples are lost or late
# Lowest rate (Hz): below it the lifetime of commands does not grow any more, and pushes become coarse.
SLOWEST_HZ = round(LIFETIME_PERIODS / LONGEST_LIFETIME_S)
MOST_LOST_SHARE = 0.02  # largest fraction of lost samples that are filled in
LONGEST_FILLED = 3  # largest number of successive lost samples


Result = TypeVar("Result")


class TimingError(IdentificationError):
    """Too many samples of a motion were lost or late; the motion may be repeated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeRigRequest(RigRequest):
    """A request of a motion with a free handle: rig and device; the experiment's wall and trial have no effect."""

    verified: Annotated[
        bool, Keyword("On a real rig: a push of the wrong sign cannot do harm.", group="Device")
    ] = False


def refuse_unverified(device: FramedDevice, *, verified: bool) -> None:
    """Raise `ConfigError` for a real rig if the caller has not declared the signs of motor and encoder as verified."""
    if device.dictionary.simulated or verified:
        return
    raise ConfigError(
        f"the polarity of motor and encoder of {device.dictionary.device} is not verified, so the device is not armed",
        remedy="make sure that a push of the wrong sign cannot do harm, put the handle at position "
        "zero, and give `verified`: the first pushes check the signs, and end after a few counts "
        "in any case",
    )


def position_now(device: FramedDevice, experiment: Experiment, reference_count: int) -> float:
    """Return the position of the handle (rad or m); raise `PlanError` if the handle is outside of its window."""
    at = controller.resolution(experiment) * (device.count() - reference_count)
    limits = experiment.rig.limits
    if not limits.position_minimum < at < limits.position_maximum:
        raise PlanError(
            f"the handle is at {at:.4g} {unit_of('position', experiment.rig.motion)}, outside of its window "
            f"({limits.position_minimum:.4g} to {limits.position_maximum:.4g})",
            remedy="move the handle into the window by hand",
        )
    return at


def run_motion(
    device: FramedDevice,
    motion: IdentificationMotion,
    recording: Path,
    *,
    verified: bool,
    reference_count: int,
    extra: Mapping[str, Any],
    leaves_switch: bool = False,
) -> tuple[NDArray[np.void], Path]:
    """Run a motion; return its logged samples, one for each tick, and the path of the recording.

    `recording` is the path of a file that must not exist yet; `extra` is added to its header. `verified` is True if the
    signs of motor and encoder were checked; `reference_count` is the encoder count at position zero. With
    `leaves_switch` the motion may begin with a pressed limit switch.

    Raises
    ------
    TimingError
        Too many samples were lost or late.
    RigError
        The trial ended early; the effort is zero.
    """
    experiment = motion.experiment
    run = prepared_on(
        device,
        experiment,
        verified=verified or device.dictionary.simulated,
        reference_count=reference_count,
        law=motion.law,
    )
    seed = experiment.trial.seed
    end = run_trial(
        device,
        TrialRequest(run=run, recording=recording, seed=seed, extra=dict(extra), leaves_switch=leaves_switch),
    )
    assert end.sealed is not None
    return trial_rows(end.sealed, motion.phases), end.recording


def trial_rows(recording: Recording, phases: Sequence[Phase] = (Phase.TRIAL,)) -> NDArray[np.void]:
    """Return the samples of some phases of a recording, one for each tick; raise `TimingError` if too many are lost."""
    return whole(recording, recording.rows[np.isin(recording.rows["phase"], phases)])


def whole(recording: Recording, rows: NDArray[np.void]) -> NDArray[np.void]:
    """Return logged samples (`rows`) with the lost ones filled in, so that there is one for each tick.

    Positions are interpolated linearly; lost ticks get the effort that the next sample reports. Raise `TimingError` if
    more than 2 % of the samples, or more than three in succession, are lost, or if too many were late.
    """
    if len(rows) < 2:
        raise TimingError(
            f"{recording.path}: the motion has {len(rows)} samples; at least 2 are needed",
            remedy="repeat the motion",
        )
    rate = int(recording.header["experiment"]["controller"]["position_rate"])
    apart = np.diff(rows["sample_index"])
    longest, lost = int(apart.max()) - 1, int((apart - 1).sum())
    share = lost / (len(rows) + lost)
    if apart.min() < 1 or longest > LONGEST_FILLED or share > MOST_LOST_SHARE:
        slower = max(1, min(rate // 2, rate * LONGEST_FILLED // max(longest, 1)))
        raise TimingError(
            f"{recording.path}: {100 * share:.2g} % of the samples are missing, up to {longest} in a row; allowed are "
            f"{100 * MOST_LOST_SHARE:g} % and {LONGEST_FILLED} in a row",
            remedy=f"end other programs on the computer, or choose `rate` {slower}, at which the longest "
            f"gap is {math.floor(longest * slower / rate)} samples",
        )
    late = float(np.mean((rows["flags"] & RowFlag.LATE) != 0))
    # If the board ran the law, only the report was late.
    if late > LATE_SHARE and recording.header["extra"].get("loop") != "device":
        raise TimingError(
            f"{recording.path}: {100 * late:.1f} % of the ticks were late, allowed are {100 * LATE_SHARE:g} %",
            remedy=f"end other programs on the computer, or choose `rate` {rate // 2}",
        )
    # The excitation stays in step with the filled samples, because laws count elapsed ticks.
    return _fill_lost(rows) if lost else rows


def _fill_lost(rows: NDArray[np.void]) -> NDArray[np.void]:
    index = rows["sample_index"].astype(np.int64)
    ticks = np.arange(index[0], index[-1] + 1)
    after = np.searchsorted(index, ticks)
    whole = rows[np.searchsorted(index, ticks, side="right") - 1]
    whole["sample_index"] = ticks
    whole["position"] = np.interp(ticks, index, rows["position"])
    for name in ("effort_applied", "current_applied"):
        whole[name] = rows[name][after]
    return whole


class Pushes(NamedTuple):
    """Result of several small pushes that check a rig.

    Attributes
    ----------
    rows
        Logged samples of all pushes and of the rests between them.
    recording
        Path of the recording; the recording of the first push if each push has a file.
    ended
        Error with which the device ended the last push because nothing moved; None without such an error.
    """

    rows: NDArray[np.void]
    recording: Path
    ended: DeviceFaultError | None = None


def stalled(error: DeviceFaultError) -> Recording:
    """Return the recording of pushes that the device ended because the handle did not move; else raise `error`."""
    end = end_of(error)
    sealed = None if end is None else end.sealed
    fault = None if sealed is None else (sealed.trailer or {}).get("fault")
    if sealed is None or not fault or fault["name"] != Fault.RUNAWAY.name:
        raise error
    return sealed


def spoiled_by_timing(error: RigError) -> bool:
    """Return True if a motion ended early, or cannot be used, because the computer or the link was late."""
    end = end_of(error)
    if isinstance(error, TimingError) or end is None:
        return isinstance(error, TimingError)
    fault = ((end.sealed.trailer or {}).get("fault") or {}) if end.sealed is not None else {}
    lost = end.reason == EndReason.DEVICE_FAULT and fault.get("name") == Fault.LINK_LOST.name
    return lost or end.reason in (EndReason.LINK_SILENT, EndReason.LINK_DELAYED, EndReason.OVERRUN)


def repeat_if_late(device: FramedDevice, run: Callable[[], Result], rate_hz: int) -> tuple[Result, int]:
    """Run a motion, and again if samples are late or lost; return its result and the number of repetitions.

    `rate_hz` is the rate of the loop (Hz). The fourth failure raises its error, with a rate as remedy that tolerates
    the longest gap between two samples.
    """
    for repeated in range(ATTEMPTS):
        try:
            return run(), repeated
        except RigError as error:
            if not spoiled_by_timing(error):
                raise
            if repeated + 1 == ATTEMPTS or device.link.clock.virtual:
                if (silence_s := silence_of(error)) is not None:
                    error.remedy = advice(silence_s, rate_hz)
                raise
    raise AssertionError


def bearing_rate(silence_s: float) -> int:
    """Return the highest loop rate (Hz) at which a command lives at least twice as long as the gap `silence_s` (s)."""
    rate_hz = rate_of_lifetime(silence_s / LIFETIME_SHARE)
    return rate_hz - rate_hz % RATE_STEP


def advice(silence_s: float, rate_hz: int) -> str:
    """Return what to do after a gap of `silence_s` (s) without a command ended a run at `rate_hz` (Hz)."""
    bearing = bearing_rate(silence_s)
    if SLOWEST_HZ <= bearing < rate_hz:
        return (
            f"choose `rate` {bearing}: half of its commands' lifetime covers the {1e3 * silence_s:.3g} ms "
            "without a command"
        )
    return (
        f"end other programs on the computer, or grant real-time scheduling (`rig doctor` shows how): no rate from "
        f"{SLOWEST_HZ} Hz up tolerates {1e3 * silence_s:.3g} ms without a command"
    )


def silence_of(error: RigError) -> float | None:
    """Return the longest time between two samples in the run that raised `error` (s); None without a recording."""
    end = end_of(error)
    if end is None or end.sealed is None or len(end.sealed.rows) < 2:
        return None
    return 1e-9 * float(np.diff(end.sealed.rows["received_at"]).max())


def signs_of(experiment: Experiment, rows: NDArray[np.void], rate: float) -> SignCheck:
    """Compare the logged samples of pushes (`rate` in Hz) with the described rig: direction, inertia and friction."""
    return check_signs(
        np.arange(len(rows)) / rate,
        # The effort that the next sample reports: a slow loop or a late command delays the sent one.
        np.append(rows["effort_applied"][1:], rows["effort_sent"][-1]),
        rows["position"],
        resolution=experiment.rig.encoder.resolution,
        expected_inertia=experiment.rig.mechanics.inertia,
        rest_s=0.25 * REST_S,
        damping=config.rig_model(experiment).damping,
        friction=coulomb_of(experiment),
    )
