"""Run one motion of a rig with a free handle as a recorded trial on an open device; return every sample of it."""

from __future__ import annotations

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
    inertia_of,
)
from rig.experiments.trials._trial import TrialRequest, end_of, run_trial
from rig.experiments.trials.preparation import prepared_on
from rig.experiments.trials.settings import RigRequest
from rig.loop.layout import EndReason
from rig.recording.data import Recording

# Of the ticks: such an effort acts later, and what acted when is recorded. In 240 simulated runs with 0.1 to 20 % of
# late commands (2026-11-29) no fit missed the inertia by more than 1.5 times its interval; of the 73 with 1 to 5 %
# coherence or the change from period to period refuses all but 3.
LATE_SHARE = 0.05
ATTEMPTS = 4  # of a motion at one rate, when lost or late samples spoil it
# Below it commands live no longer, and pushes get coarse.
SLOWEST_HZ = round(LIFETIME_PERIODS / LONGEST_LIFETIME_S)
MOST_LOST_SHARE = 0.02  # of a motion's samples: so many are filled in
LONGEST_FILLED = 3  # lost samples in a row


Result = TypeVar("Result")


class TimingError(IdentificationError):
    """Too many samples were lost or late: the motion may be measured again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeRigRequest(RigRequest):
    """Which rig is to move with a free handle, and where; the wall and the trial of it are not used."""

    verified: Annotated[
        bool, Keyword("On a real rig: a push of the wrong sign cannot do harm.", group="Device")
    ] = False


def refuse_unverified(device: FramedDevice, *, verified: bool) -> None:
    """Raise `ConfigError` for a real rig whose signs the caller has not declared as verified."""
    if device.dictionary.simulated or verified:
        return
    raise ConfigError(
        f"the polarity of motor and encoder of {device.dictionary.device} is not verified, so it does not arm",
        remedy="make sure that a push of the wrong sign cannot do harm, put the handle at position "
        "zero, and give `verified`: the first pushes check the signs, and end after a few counts "
        "in any case",
    )


def position_now(device: FramedDevice, x: Experiment, reference_count: int) -> float:
    """Return where the handle is (rad or m); raises `PlanError` outside of its window."""
    at = controller.resolution(x) * (device.count() - reference_count)
    limits = x.rig.limits
    if not limits.position_minimum < at < limits.position_maximum:
        raise PlanError(
            f"the handle is at {at:.4g} {unit_of('position', x.rig.motion)}, outside of its window",
            remedy="move it into the window by hand",
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
    """Run a motion, and return the rows of its phases, without a gap, and the sealed recording.

    Parameters
    ----------
    device
        Open, at rest.
    motion
        Motion, and its limits.
    recording
        The capture to write; a file that does not exist.
    verified, reference_count
        As in `rig.experiments.hits.hit.HitRequest`.
    extra
        For the recording's header.
    leaves_switch
        As in `rig.experiments.trials._trial.TrialRequest`.

    Raises
    ------
    TimingError
        Samples were lost or late.
    RigError
        Whatever ended the trial early; the effort is zero.
    """
    x = motion.experiment
    run = prepared_on(
        device,
        x,
        verified=verified or device.dictionary.simulated,
        reference_count=reference_count,
        law=motion.law,
    )
    end = run_trial(
        device,
        TrialRequest(
            run=run, recording=recording, seed=x.trial.seed, extra=dict(extra), leaves_switch=leaves_switch
        ),
    )
    assert end.sealed is not None
    return trial_rows(end.sealed, motion.phases), end.recording


def trial_rows(recording: Recording, phases: Sequence[Phase] = (Phase.TRIAL,)) -> NDArray[np.void]:
    """Return rows of the trial proper, or of these phases; errors as `whole`."""
    return whole(recording, recording.rows[np.isin(recording.rows["phase"], phases)])


def whole(recording: Recording, rows: NDArray[np.void]) -> NDArray[np.void]:
    """Return these rows of a recording, one for each tick.

    Up to `MOST_LOST_SHARE` of them, `LONGEST_FILLED` in a row, may be lost: positions between two samples are on a
    straight line, and the effort that the next sample reports has acted since the one before. Laws count elapsed ticks,
    so that an excitation stays in step.

    Raises `TimingError` when more are missing; or when too many were late, unless the board ran the law: then only the
    report is late.
    """
    if len(rows) < 2:
        raise TimingError(
            f"{recording.path}: the motion has only {len(rows)} samples", remedy="measure it again"
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
    if late > LATE_SHARE and recording.header["extra"].get("loop") != "device":
        raise TimingError(
            f"{recording.path}: {100 * late:.1f} % of the ticks were late, allowed are {100 * LATE_SHARE:g} %",
            remedy=f"end other programs on the computer, or choose `rate` {rate // 2}",
        )
    return _fill_lost(rows) if lost else rows


def _fill_lost(rows: NDArray[np.void]) -> NDArray[np.void]:
    """Return one row for each tick: what was lost is the row before, with what is known of the time in between."""
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
    """Pushes that were made.

    Attributes
    ----------
    rows
        All of them, with rests in between.
    recording
        The sealed file; of the first, where each has its own.
    ended
        The fault by which the device ended the last for want of motion, if it did.
    """

    rows: NDArray[np.void]
    recording: Path
    ended: DeviceFaultError | None = None


def stalled(error: DeviceFaultError) -> Recording:
    """The recording of pushes that the device ended for want of motion: what they show says more. Else raises it."""
    end = end_of(error)
    sealed = None if end is None else end.sealed
    fault = None if sealed is None else (sealed.trailer or {}).get("fault")
    if sealed is None or not fault or fault["name"] != Fault.RUNAWAY.name:
        raise error
    return sealed


def spoiled_by_timing(error: RigError) -> bool:
    """Return True if a motion ended, or is of no use, because the computer or the link was late."""
    end = end_of(error)
    if isinstance(error, TimingError) or end is None:
        return isinstance(error, TimingError)
    fault = ((end.sealed.trailer or {}).get("fault") or {}) if end.sealed is not None else {}
    lost = end.reason == EndReason.DEVICE_FAULT and fault.get("name") == Fault.LINK_LOST.name
    return lost or end.reason in (EndReason.LINK_SILENT, EndReason.LINK_DELAYED, EndReason.OVERRUN)


def repeat_if_late(device: FramedDevice, run: Callable[[], Result], rate_hz: int) -> tuple[Result, int]:
    """Run a motion at a rate (Hz), again while late or lost samples spoil it; return its result and the repetitions.

    The error of the last attempt names the rate that outlives the longest silence in it.
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
    """Return the highest rate whose commands live for twice this silence (Hz)."""
    rate_hz = rate_of_lifetime(silence_s / LIFETIME_SHARE)
    return rate_hz - rate_hz % RATE_STEP


def advice(silence_s: float, rate_hz: int) -> str:
    """Return the remedy for a run at a rate (Hz) that was spoiled by such a silence of the computer or the link."""
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
    """Longest time without a sample in the run that ended in this error (s), None where it has no recording."""
    end = end_of(error)
    if end is None or end.sealed is None or len(end.sealed.rows) < 2:
        return None
    return 1e-9 * float(np.diff(end.sealed.rows["received_at"]).max())


def signs_of(x: Experiment, rows: NDArray[np.void], rate: float) -> SignCheck:
    """Compare pushes (`identify_motions.pushes_motion`), recorded at a rate (Hz), with the described rig.

    The effort is the one that the device reports with the next sample, since a slow loop or a late command delays it.
    """
    return check_signs(
        np.arange(len(rows)) / rate,
        np.append(rows["effort_applied"][1:], rows["effort_sent"][-1]),
        rows["position"],
        resolution=x.rig.encoder.resolution,
        expected_inertia=inertia_of(x),
        rest_s=0.25 * REST_S,
        damping=config.rig_model(x).damping,
        friction=coulomb_of(x),
    )
