"""Send a torque pulse before a person takes the handle, to check that the rig moves as described in both directions.

    found = pulse(device, experiment, recording=Path("pulse.rigcap"), verified=True, reference_count=0)
    found.ok, found.checks

`rig device check`, the admission of a hit, identification, the search for a reference and sessions call this module. A
check must not pass without an observed motion.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig import config, devices
from rig.analysis.identification import IdentificationError, SignCheck
from rig.config import Experiment
from rig.core.check import Check, Outcome, refuse, refused
from rig.core.errors import DeviceFaultError
from rig.core.present import reported
from rig.core.same_rig import check_rig
from rig.core.sample import unit_of
from rig.core.this_system import refuse_real_time
from rig.devices.framed import FramedDevice
from rig.experiments.motion._board_pushes import board_pushes
from rig.experiments.motion._motion_run import (
    FreeRigRequest,
    Pushes,
    position_now,
    refuse_unverified,
    repeat_if_late,
    run_motion,
    signs_of,
    stalled,
    trial_rows,
)
from rig.experiments.trials._endings import IN_DOUBT
from rig.experiments.trials._identify_motions import (
    coulomb_of,
    most_push,
    observable_check,
    push_growth,
    push_way,
    pushes_motion,
    slow_rate,
    still,
)
from rig.experiments.trials.plan import link_checks
from rig.experiments.trials.preparation import position_zero
from rig.realtime import stop_requests
from rig.recording.files import free_name, plain_errors

__all__ = [
    "IN_DOUBT",
    "NO_HANDS",
    "PUSHES",
    "FreeRigRequest",
    "Pulse",
    "at_own_rate",
    "check_rig_moves",
    "energy_of",
    "judged",
    "most_push",
    "pulse",
    "push_way",
]

# Two pushes in each direction, each growing until the handle has moved a few counts: they need no current sensor and no
# known sign, and their energy is at most `energy_of`.
PUSHES = 4
# Rules that were fixed before their results (`tests/benchmarks/pulses.py`): largest factor between measured and
# described inertia; latest begin of the motion over the time that the described friction implies, plus this time (s).
SAME_SCALE, SAME_FRICTION, LATEST_S = 1.6, 2.0, 0.05

NO_HANDS = "hands off the handle: the motor moves it a little, both ways"


@dataclass(frozen=True, kw_only=True)
class Pulse:
    """A result of a torque pulse, which consists of several pushes.

    Attributes
    ----------
    rig, motion, device
        Name of the rig, its kind of motion (which determines the units), and name of the device.
    recording
        Recording of the pushes; the recording of the first push if the board ran each push as a trial.
    signs
        Measured motion of the pushes.
    checks
        Checks of the motion, its direction, its size and its delay.
    """

    rig: str
    motion: str
    device: str
    recording: Path
    signs: SignCheck = field(repr=False)
    checks: tuple[Check, ...]

    @reported
    def ok(self) -> bool:
        """Return True if no check of the torque pulse is refused, so that a person may hold the rig."""
        return not refused(self.checks)

    def insist(self) -> None:
        """Raise `IdentificationError`, with reasons and remedies, if the rig did not move as described."""
        if found := refused(self.checks):
            raise IdentificationError(
                "the rig does not move as it is described: "
                + "; ".join(f"{one.name}: {one.text}" for one in found),
                remedy="; ".join(one.remedy for one in found),
            )


def check_rig_moves(request: FreeRigRequest) -> Pulse:
    """Open a device and send a torque pulse to check that the rig moves as described; raise `RigError` on failure."""
    experiment = config.override(request.experiment, request.changes)
    url = devices.url_for(request.url or "sim://", experiment.controller.loop)
    with devices.open_device(url, config.rig_model(still(experiment))) as device:
        output = Path(request.output)
        with plain_errors("make", output):
            output.mkdir(parents=True, exist_ok=True)
        return pulse(
            device,
            experiment,
            recording=free_name(output, f"{experiment.rig.name}-pulse"),
            verified=request.verified,
            reference_count=position_zero(device, experiment),
        )


@stop_requests.together()
def pulse(
    device: FramedDevice, experiment: Experiment, *, recording: Path, verified: bool, reference_count: int
) -> Pulse:
    """Push a rig with a free handle, and compare its motion with the described rig.

    Parameters
    ----------
    device
        Open device, at rest. Its `moved_as_described` becomes True if all checks pass (or only warn), else False.
    experiment
        Description of the rig, with its limits.
    recording
        Path of the recording to write.
    verified, reference_count
        True if the signs of motor and encoder were checked; encoder count at position zero.

    Raises
    ------
    PlanError
        The device has another rig, or the motion is not permitted; nothing has moved.
    ConfigError
        The polarity of a real rig's motor and encoder is not verified.
    RigError
        A push ended early; the effort is zero.
    """
    # Reset first: if this function raises, the rig must not be armed because of an older pulse.
    device.moved_as_described = False
    refuse_unverified(device, verified=verified)
    refuse([check_rig(config.rig_model(still(experiment)), device.dictionary)])
    changes = at_own_rate(experiment, device)
    if experiment.trial.kind == "human":  # the end mass is mounted in automated trials only
        changes["rig.mechanics.end_mass"] = 0.0
    experiment = config.override(experiment, changes, "the torque pulse")
    on_board = experiment.controller.loop == "device"
    if not on_board and not device.link.clock.virtual:
        refuse_real_time('the torque pulse of controller.loop = "host"')
    most_hz, bytes_per_second = device.dictionary.position_rate_maximum, device.link.bytes_per_second
    refuse(link_checks(still(experiment), most_hz, bytes_per_second))
    push = board_pushes if on_board else _host_pushes
    described = {"pushes": PUSHES, "most_effort": most_push(experiment), "way": push_way(experiment)}
    made = push(
        device,
        experiment,
        PUSHES,
        recording,
        verified=verified,
        reference_count=reference_count,
        extra={"pulse": described},
    )
    signs = signs_of(experiment, made.rows, slow_rate(experiment))
    found = Pulse(
        rig=experiment.rig.name,
        motion=experiment.rig.motion,
        device=device.dictionary.device,
        recording=made.recording,
        signs=signs,
        checks=judged(experiment, signs),
    )
    if made.ended is not None and found.ok:
        raise made.ended
    device.moved_as_described = found.ok
    return found


def _host_pushes(
    device: FramedDevice,
    experiment: Experiment,
    pushes: int,
    recording: Path,
    *,
    verified: bool,
    reference_count: int,
    extra: Mapping[str, Any],
) -> Pushes:
    """Run all pushes in one trial, by a law on this computer; return their samples and recording."""

    def run() -> tuple[NDArray[np.void], Path]:
        used = any(recording.with_suffix(suffix).exists() for suffix in (".rigcap", ".parquet"))
        return run_motion(
            device,
            pushes_motion(experiment, position_now(device, experiment, reference_count), pushes),
            free_name(recording.parent, recording.stem) if used else recording,
            verified=verified,
            reference_count=reference_count,
            extra=extra,
            leaves_switch=True,
        )

    try:
        (rows, path), _ = repeat_if_late(device, run, slow_rate(experiment))
    except DeviceFaultError as error:
        sealed = stalled(error)
        assert sealed.path is not None
        return Pushes(trial_rows(sealed), sealed.path, error)
    return Pushes(rows, path)


def at_own_rate(experiment: Experiment, device: FramedDevice) -> dict[str, Any]:
    """Return by key the loop rates for slow motions on a device (at most 2 kHz); empty in virtual time."""
    if device.link.clock.virtual:
        return {}
    rate = min(device.dictionary.position_rate_default, slow_rate(experiment))
    return dict.fromkeys(("controller.position_rate", "controller.velocity_rate"), rate)


def energy_of(experiment: Experiment) -> float:
    """Return the largest energy of one push of a torque pulse (J): its largest effort times its travel."""
    return most_push(experiment) * push_way(experiment)


def judged(experiment: Experiment, signs: SignCheck) -> tuple[Check, ...]:
    """Return checks of pushes against the described rig: motion, direction, size (inertia) and delay."""
    most, coulomb = most_push(experiment), coulomb_of(experiment)
    effort = unit_of("effort", experiment.rig.motion)
    moved = [push for push in signs.pushes if push.moved]
    # Friction above the largest push cannot be distinguished from a dead motor: without motion the rig is not armed for
    # a person.
    if not moved:
        return (_judge_unmoved(experiment, signs, most, coulomb, effort),)
    sizes = [push.inertia for push in moved if math.isfinite(push.inertia)]
    begins = float(np.median([push.began_s for push in moved]))
    expected = coulomb / push_growth(experiment)
    latest = SAME_FRICTION * expected + LATEST_S
    return (
        _check(
            "motion",
            len(moved) == PUSHES,
            f"only {len(moved)} of {PUSHES} pushes of at most {most:.3g} {effort} moved the handle",
            "keep everything off the handle, then check again; a contact of motor or encoder may be loose",
        ),
        _check(
            "direction",
            signs.sign == 1,
            "a positive effort raises the position"
            if signs.sign == 1
            else "a positive effort lowers the position"
            if signs.sign == -1
            else "some pushes moved the handle along, some against",
            "motor or encoder are connected in reverse: swap two wires, or change the sign of "
            "rig.encoder.sign"
            if signs.sign == -1
            else "take all hands off the handle, then check again",
        ),
        _check(
            "size",
            len(sizes) > 0 and 1.0 / SAME_SCALE <= signs.scale <= SAME_SCALE,
            f"the response to pushes shows {signs.scale:.2g} times the described inertia; a factor of "
            f"up to {SAME_SCALE:g} is accepted",
            "check the torque constant, the ratio and the decoding of the encoder (a half or a "
            "quarter: it counts two or four for one; twice: half of the effort), and that no hand "
            "holds the handle",
        ),
        Check(
            "delay",
            Outcome.OK if begins <= latest else Outcome.WARNING,
            f"the handle begins to move {begins:.3g} s into a push, {begins * push_growth(experiment):.3g} {effort}; "
            f"described friction {coulomb:.3g} {effort}: {expected:.3g} s, at the latest {latest:.3g} s",
            "friction is larger than described, or the effort comes late: `rig identify` measures both",
        ),
    )


def _judge_unmoved(
    experiment: Experiment, signs: SignCheck, most: float, coulomb: float, effort: str
) -> Check:
    seen = max((push.seen for push in signs.pushes), default=0.0)
    text = f"nothing moved, up to {most:.3g} {effort}"
    if (hidden := observable_check(experiment)).outcome is not Outcome.OK:
        bears = " if the rig tolerates it, or free the mechanism" if hidden.changes else ""
        return _check("motion", False, f"not observed: {text}; {hidden.text}", f"{hidden.remedy}{bears}")
    if seen > 0.5 * experiment.rig.encoder.resolution:
        return _check(
            "motion",
            False,
            f"the count alternates between two values, up to {most:.3g} {effort}: a channel of the "
            "encoder is dead",
            "check both channels of the encoder and their wires",
        )
    times = f", {most / coulomb:.2g} times the described friction" if coulomb > 0.0 else ""
    return _check(
        "motion",
        False,
        f"{text}{times}: the motor or the encoder is dead, or the handle is blocked or its friction "
        "is larger than that",
        "move the handle by hand: if the position follows (`rig device show URL`), check the motor's "
        "leads and the amplifier's supply, or enter its friction (rig.mechanics.motor_coulomb); if "
        "not, check the encoder's wires and supply",
    )


def _check(name: str, holds: bool, text: str, remedy: str) -> Check:
    return Check(name, Outcome.OK if holds else Outcome.REFUSED, text, "" if holds else remedy)
