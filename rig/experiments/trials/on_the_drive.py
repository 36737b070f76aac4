"""A wall that a drive renders itself (`controller.arithmetic = "drive"`): what is lost, and whether a drive can."""

from __future__ import annotations

from firmware_protocol.dictionary import Dictionary
from rig.config import Experiment
from rig.core.check import Check, Outcome
from rig.core.sample import unit_of
from rig.experiments.trials.planned import limited

NAME = "wall on the drive"
SPARE = 1.01  # of gains that are proposed, for their rounding
STANDS_FOR_NO_DRIVE = (
    "simulated with the law of the host, at its rate and with its estimator; a drive that renders "
    "the wall itself has its own, so its result will differ"
)


def is_on_the_drive(experiment: Experiment) -> bool:
    """Return True if the drive behind a bridge renders the wall."""
    return experiment.controller.loop == "device" and experiment.controller.arithmetic == "drive"


def lost(experiment: Experiment) -> list[Check]:
    """Return a note for a plan on what a wall on the drive does not have; empty for other walls."""
    if not is_on_the_drive(experiment):
        return []
    rate = experiment.controller.position_rate
    return [
        Check(
            NAME,
            Outcome.OK,
            "the drive's own spring and damper, its rate, its filter: no velocity rate and no estimator of this "
            f"package, and no slew limit at the wall; homing, phases and limits at {rate} Hz, and one sample of the "
            "drive's effort for each of these ticks",
            "",
        )
    ]


def fits(experiment: Experiment, dictionary: Dictionary) -> list[Check]:
    """Check that the gains of a drive are large enough for an experiment's wall that this drive renders."""
    told = {info.name: info.value for info in dictionary.settings}
    if not is_on_the_drive(experiment):
        return []
    most = [told.get(name) for name in ("drive_wall_stiffness", "drive_wall_damping")]
    if not all(isinstance(value, int | float) for value in most):
        why = told.get("drive_wall", "it is not a drive behind a bridge")
        return [
            Check(
                NAME,
                Outcome.REFUSED,
                f"{dictionary.device} cannot render a wall itself: {why}",
                'choose controller.arithmetic = "float32", or let the host run the law (controller.loop = "host")',
            )
        ]
    stiffness, damping = (float(value or 0.0) for value in most)
    wall, motion = experiment.wall, experiment.rig.motion
    k_share, b_share = wall.stiffness / stiffness, wall.damping / damping
    k_unit, b_unit = (unit_of(name, motion) for name in ("stiffness", "damping"))
    text = (
        f"K = {wall.stiffness:g} {k_unit} is {k_share:.3g} of what the drive's kp gives, {stiffness:.4g}; "
        f"B = {wall.damping:g} {b_unit} is {b_share:.3g} of its kd's, {damping:.4g}"
    )
    kp, kd = float(told["drive_kp"]), float(told["drive_kd"])
    larger = kp * max(1.0, SPARE * k_share)
    return [
        limited(
            NAME,
            b_share <= k_share <= 1.0,
            f"{text}; at most 1, and the damper's share at most the spring's",
            f"raise the gains of the drive: conf set servo.pid_position.kp {larger:.4g}, "
            f"conf set servo.pid_position.kd {kd * max(1.0, SPARE * b_share * larger / (kp * k_share or kp)):.4g}",
        )
    ]
