"""Run small pushes on a board: each push is a trial against a wall of no stiffness, which every board can run.

    made = board_pushes(device, x, 4, Path("pulse.rigcap"), verified=True, reference_count=0, extra={})
    made.rows, made.recording

`pulse` calls this module if the board runs the law (`controller.loop = "device"`). It must not run a law on this
computer.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rig.analysis.identification import IdentificationError
from rig.config import Experiment
from rig.config.prepared_run import PreparedRun
from rig.control.motions import ALIKE, NOTHING
from rig.core.check import refuse
from rig.core.errors import DeviceFaultError, GuardError
from rig.core.sample import Phase
from rig.devices.framed import FramedDevice
from rig.experiments.motion._motion_run import Pushes, position_now, stalled, whole
from rig.experiments.trials._identify_motions import REST_S, push_way, pushes_motion, single_push
from rig.experiments.trials._trial import TrialRequest, end_of, run_trial
from rig.experiments.trials.plan import device_checks
from rig.experiments.trials.preparation import prepared_on
from rig.loop.layout import EndReason
from rig.recording.data import Recording
from rig.recording.files import free_name

AROUND = ("slew_limit", "window_minimum", "window_maximum")  # limits of the device around its law
PUSH_ENDS = (
    EndReason.OUT_OF_WINDOW,
    EndReason.DEVICE_ENDED,
)  # the window ended the run, in both laws or the board's
LOOKS = 25  # checks of `REST_S` seconds each until the handle must rest


def board_pushes(
    device: FramedDevice,
    experiment: Experiment,
    pushes: int,
    recording: Path,
    *,
    verified: bool,
    reference_count: int,
    extra: Mapping[str, Any],
) -> Pushes:
    """Run pushes on the board, two in one direction, two in the other, and so on; return their samples and recording.

    The law of `experiment` runs on the board. `recording` is the path of the first push's recording; the recordings of
    later pushes are beside it, with numbers, and `extra` is added to their headers. `verified` is True if the signs of
    motor and encoder were checked; `reference_count` is the encoder count at position zero.

    Raises
    ------
    PlanError
        The board cannot run a law; nothing has moved.
    IdentificationError
        The handle does not rest, or samples were lost.
    RigError
        A push ended early for another reason; the effort is zero.
    """
    recorded: list[Recording] = []
    rows: list[NDArray[np.void]] = []
    ended: DeviceFaultError | None = None
    for number in range(pushes):
        at = _at_rest(device, experiment, reference_count)
        way: Literal[-1, 1] = 1 if number % (2 * ALIKE) < ALIKE else -1
        run = _prepare_push(device, experiment, at, way, verified=verified, zero=reference_count)
        refuse(device_checks(run, device.dictionary))
        request = TrialRequest(
            run=run,
            recording=free_name(recording.parent, recording.stem),
            seed=experiment.trial.seed,
            extra={**extra, "push": number + 1},
            leaves_switch=True,
        )
        try:
            recorded.append(_run_push(device, request))
        except DeviceFaultError as error:
            ended = error
            recorded.append(stalled(error))
        rows.append(whole(recorded[-1], recorded[-1].rows))
        if ended is not None:
            break
        pushed = rows[-1]["position"][rows[-1]["phase"] == Phase.TRIAL]
        if not len(pushed):
            raise _make_restless_error()
        if np.ptp(pushed) < NOTHING * push_way(experiment):
            break  # as in `nudges`
    path = recorded[0].path
    assert path is not None
    return Pushes(np.concatenate(rows), path, ended)


def _at_rest(device: FramedDevice, experiment: Experiment, reference_count: int) -> float:
    """Wait until the handle rests, and return its position (rad or m); the count may alternate between two values."""
    for _ in range(LOOKS):
        counts = [state.count for state in device.states(REST_S)]
        if len(counts) > 1 and max(counts) - min(counts) <= 1:
            return position_now(device, experiment, reference_count)
    raise _make_restless_error()


def _make_restless_error() -> IdentificationError:
    return IdentificationError(
        "the handle does not rest, so the result of a push would be meaningless",
        remedy="take all hands off the handle and remove what pulls it, then check again",
    )


def _prepare_push(
    device: FramedDevice, experiment: Experiment, at: float, way: Literal[-1, 1], *, verified: bool, zero: int
) -> PreparedRun:
    given: dict[str, Any] = {
        "verified": verified or device.dictionary.simulated,
        "reference_count": zero,
    }
    # The board alone limits a push: its travel by the window of its law, with zero effort in the same tick; its effort
    # by the constant effort, which grows with the slew limit; its time by the length of the trial. If this computer
    # sends nothing, the effort is zero after `controller.supervise_lifetime_s` and the ramp. The device around the law
    # has the wider limits of all pushes: with the slew limit of a push a ramp down would take as long as the growth.
    around = prepared_on(device, pushes_motion(experiment, at).experiment, **given)
    run = prepared_on(device, single_push(experiment, at, way), **given)
    return replace(run, parameters={**run.parameters, **{name: around.parameters[name] for name in AROUND}})


def _run_push(device: FramedDevice, request: TrialRequest) -> Recording:
    """Run one push and return its recording; it normally ends early, when the handle leaves a small window."""
    try:
        end = run_trial(device, request)
    except GuardError as error:
        found = end_of(error)
        if found is None or found.reason not in PUSH_ENDS or found.sealed is None:
            raise
        end = found
    assert end.sealed is not None
    return end.sealed
