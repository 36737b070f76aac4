"""Check that a wall may run at its rate on a device: the same checks for `rig doctor`, the arming gate and `rig hit`.

`admit` is the last check before a trial moves the motor; every caller of `rig.experiments.hits.hit.hit` passes it: `rig
hit`, the console, sessions and `rig.testing`. This module must not run the trial. It moves nothing, except for the
torque pulse before a device is armed for a person.
"""

from pathlib import Path

from rig import config
from rig.config import Experiment
from rig.config.prepared_run import PreparedRun
from rig.control.laws import Law
from rig.core.check import Check, Outcome, refuse, refused
from rig.core.errors import ConfigError
from rig.core.same_rig import check_rig
from rig.devices.framed import FramedDevice
from rig.doctor.gate import check_armable
from rig.doctor.gate_result import Gate
from rig.experiments.hits.hit import Admitted, HitRequest
from rig.experiments.motion.pulse import NO_HANDS, pulse
from rig.experiments.trials.plan import device_checks, human_limit_checks, link_checks, plan_of
from rig.experiments.trials.preparation import position_zero, prepared_on
from rig.experiments.trials.results import make_directory
from rig.recording.files import free_name


def admit(request: HitRequest, device: FramedDevice, experiment: Experiment) -> Admitted:
    """Check if an experiment may run on an open device, and return the prepared run with its warnings.

    If a person will hold the handle of a real rig, a torque pulse first checks that the rig moves as described; nothing
    else moves.

    Raises
    ------
    PlanError
        The run is not permitted on this device or over this link; nothing has moved.
    ConfigError
        The polarity of a real rig's motor and encoder is not verified.
    RigError
        The link cannot be measured, or the torque pulse failed; the effort is zero.
    """
    run = vetted(request, device, experiment)
    gate = _gate(request, device, run.experiment)
    warnings = tuple(
        one.sentence for one in human_limit_checks(run.experiment) if one.outcome is not Outcome.OK
    )
    _check_it_moves(request, device, run)
    return Admitted(run=run, gate=gate, warnings=warnings)


def vetted(request: HitRequest, device: FramedDevice, experiment: Experiment) -> PreparedRun:
    """Prepare an experiment for an open device and check it, without the checks of the link; nothing moves.

    Raises
    ------
    PlanError
        The run is not permitted, or the device was built for another rig.
    ConfigError
        The polarity of a real rig's motor and encoder is not verified.
    """
    config.check_plugins(experiment, experiment.rig.name)
    refuse([check_rig(config.rig_model(experiment), device.dictionary)])
    law = request.law
    if law is not None and not isinstance(law, Law):
        law = law(device.dictionary.current_quantum_a)
    run = prepared_on(
        device,
        experiment,
        verified=request.verified or device.dictionary.simulated,
        reference_count=_reference_count(request, device, experiment),
        law=law,
    )
    refuse(admission_checks(run, device))
    _check_verified(request, device)
    return run


def admission_checks(run: PreparedRun, device: FramedDevice) -> list[Check]:
    """Return the checks of a run on an open device that need no measurement of the link.

    The wall's stability with the link's delay is checked later, in `rig.doctor.gate.gate`.
    """
    experiment, dictionary = run.experiment, device.dictionary
    return [
        check_rig(config.rig_model(experiment), dictionary),
        *plan_of(run).checks,
        *device_checks(run, dictionary),
        *link_checks(experiment, dictionary.position_rate_maximum, device.link.bytes_per_second),
        *refused(human_limit_checks(experiment, real=not dictionary.simulated)),
    ]


def _gate(request: HitRequest, device: FramedDevice, experiment: Experiment) -> Gate | None:
    """Return the checks of the measured link (None in virtual time); raise `PlanError` if the wall is dangerous."""
    if device.link.clock.virtual:
        return None
    found = check_armable(device, experiment, anyway=request.arm_anyway, progress=request.measuring)
    if found is not None and request.judged_link is not None:
        request.judged_link(found)
    return found


def _reference_count(request: HitRequest, device: FramedDevice, experiment: Experiment) -> int:
    simulated = device.dictionary.simulated
    if not simulated and not request.verified:  # then nothing moves
        return 0
    if simulated or request.reference_count is None:
        return position_zero(device, experiment)
    return request.reference_count


def _check_it_moves(request: HitRequest, device: FramedDevice, run: PreparedRun) -> None:
    """Send a torque pulse to a real rig before a person holds it; raise if it moves otherwise than described.

    The pulse is not sent again to a device that has moved as described.
    """
    experiment = run.experiment
    if experiment.trial.kind != "human" or device.dictionary.simulated or device.moved_as_described:
        return
    output = Path(request.output)
    make_directory(output)
    if request.hands_off is not None:
        request.hands_off(NO_HANDS)
    pulse(
        device,
        experiment,
        recording=free_name(output, f"{experiment.rig.name}-pulse"),
        verified=request.verified,
        reference_count=run.reference_count,
    ).insist()


def _check_verified(request: HitRequest, device: FramedDevice) -> None:
    if device.dictionary.simulated or request.verified:
        return
    raise ConfigError(
        f"the polarity of motor and encoder of {device.dictionary.device} is not verified",
        remedy="check both at a low current limit (push the handle in the positive direction: its position must rise; "
        "a positive effort must move it in the same direction), put the handle at position zero, and give `verified`: "
        "the present count then means position zero",
    )
