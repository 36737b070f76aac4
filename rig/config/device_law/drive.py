"""What a drive that renders the wall itself has none of: a spring and a damper at its own rate is all that it gives."""

from __future__ import annotations

from rig.config.device_law.refusal import NotOnDeviceError
from rig.config.device_law.walls import Control, options
from rig.control.step import ControllerState

# The drive's own filter gives the wall its velocity. This one stands beside it, for homing and in the recording.
BESIDE = "fdm-butterworth"


def refuse_what_it_lacks(controller: ControllerState, c: Control) -> None:
    """Raise `NotOnDeviceError`, a `PlanError`, for what a drive's own wall cannot be."""
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
            bool(c["extrapolate"]),
            "controller.prediction",
            '"extrapolate"',
            "the drive does not hold the velocity between samples",
            'choose controller.prediction = "hold"',
        ),
        (
            c["slow_multiple"] != 1,
            "controller.slow_velocity_rate",
            f"{velocity_rate / c['slow_multiple']:.0f}",
            "the drive has a single rate, its own",
            "leave it out",
        ),
        (
            controller.estimator.estimator.name != BESIDE,
            "controller.estimator",
            f'"{controller.estimator.estimator.name}"',
            "the drive computes the velocity by its own filter",
            f'choose controller.estimator = "{BESIDE}", which is used only for homing and in the recording',
        ),
    )
    for there, key, shown, why, instead in lacks:
        if there:
            raise NotOnDeviceError(
                key,
                f'{shown} with controller.arithmetic = "drive"',
                f"a drive does not have it: {why}",
                instead,
            )
