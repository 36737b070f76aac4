"""Check a wall that a drive renders itself (`controller.arithmetic = "drive"`): features that a drive lacks, and gains.

The drive has only a spring and a damper, at its own rate. `rig.config.device_law._elsewhere` calls this module.
"""

from firmware_protocol.dictionary import Dictionary
from rig.config import Experiment
from rig.control.on_device import Control, NotOnDeviceError, options
from rig.control.step import ControllerState
from rig.core.check import Check, Outcome
from rig.core.sample import unit_of
from rig.experiments.trials.planned import limited

NAME = "wall on the drive"
SPARE = 1.01  # of gains that are proposed, for their rounding
# The drive's own filter gives the wall its velocity. This one stands beside it, for homing and in the recording.
BESIDE = "fdm-butterworth"


class OwnWall:
    """Checks for a wall that a drive renders itself (implements `rig.config.device_law._elsewhere.WallElsewhere`)."""

    stands_for = (
        "simulated with the law of the host, at its rate and with its estimator; a drive that renders "
        "the wall itself has its own, so its result will differ"
    )

    def refuse_what_it_lacks(self, controller: ControllerState, c: Control) -> None:
        """Raise `NotOnDeviceError` (a `PlanError`) if a setting of the wall needs a feature that a drive lacks."""
        law = controller.law
        may_pull, entry_only = options(law.law.name, law.parameters)
        velocity_rate = 1.0 / (c["tick_s"] * c["velocity_divider"])
        lacks: tuple[tuple[bool, str, str, str, str], ...] = (
            (
                law.law.name != "spring-damper",
                "wall.law",
                f'"{law.law.name}"',
                "the drive's own law is a spring and a damper beyond a bound",
                'choose wall.law = "spring-damper" without compensations',
            ),
            (
                not may_pull,
                "wall.pull",
                '"clamp"',
                "the drive does not clamp its wall",
                'choose wall.pull = "allow"',
            ),
            (
                entry_only,
                "wall.damping_on",
                '"entry"',
                "the drive damps in both directions",
                'choose wall.damping_on = "both"',
            ),
            (
                c["velocity_divider"] != 1,
                "controller.velocity_rate",
                f"{velocity_rate:.0f}",
                "the drive has a single rate, its own",
                "choose controller.velocity_rate equal to controller.position_rate",
            ),
            (
                c["position_state"] > 0,
                "wall.position_from",
                '"estimator"',
                "the drive's wall sees its encoder",
                'choose wall.position_from = "encoder"',
            ),
            (
                c["passive_damping"] > 0.0,
                "wall.passive_damping",
                f"{c['passive_damping']:g}",
                "the drive has no passivity controller",
                "choose wall.passive_damping = 0",
            ),
            (
                bool(c["extrapolate"]),
                "controller.prediction",
                '"extrapolate"',
                "the drive does not extrapolate the velocity",
                'choose controller.prediction = "hold"',
            ),
            (
                c["slow_multiple"] != 1,
                "controller.slow_velocity_rate",
                f"{velocity_rate / c['slow_multiple']:.0f}",
                "the drive has a single rate, its own",
                "remove controller.slow_velocity_rate",
            ),
            (
                controller.estimator.estimator.name != BESIDE,
                "controller.estimator",
                f'"{controller.estimator.estimator.name}"',
                "the drive computes the velocity by its own filter",
                f'choose controller.estimator = "{BESIDE}", which is used only for homing and in the recording',
            ),
        )
        for applies, key, shown, why, remedy in lacks:
            if applies:
                raise NotOnDeviceError(key, f'{shown} with controller.arithmetic = "drive"', why, remedy)

    def planned(self, experiment: Experiment) -> list[Check]:
        """Return one check for `rig experiment plan`, which states what the drive's own wall lacks."""
        rate = experiment.controller.position_rate
        return [
            Check(
                NAME,
                Outcome.OK,
                "the drive's own spring and damper, its rate, its filter: no velocity rate and no estimator of this "
                f"package, and no slew limit at the wall; homing, phases and limits at {rate} Hz, and one sample of "
                "the drive's effort for each of these ticks",
                "",
            )
        ]

    def fits(self, experiment: Experiment, dictionary: Dictionary) -> list[Check]:
        """Return one check: the gains of the connected drive are, or are not, large enough for the wall."""
        facts = {info.name: info.value for info in dictionary.settings}
        most = [facts.get(name) for name in ("drive_wall_stiffness", "drive_wall_damping")]
        if not all(isinstance(value, int | float) for value in most):
            why = facts.get("drive_wall", "it is not a drive behind a bridge")
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
        kp, kd = float(facts["drive_kp"]), float(facts["drive_kd"])
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
