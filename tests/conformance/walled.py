"""A wall that the drive renders itself, in virtual time, with a supervising host and the true motion of the handle."""

import math
from collections.abc import Mapping
from typing import Any

from firmware_protocol import messages as m
from rig import config
from rig.config import Experiment, controller, presets, rig_model
from tests.conformance.bridged import Bridged, Moteus
from tests.conformance.host import Host

GAINS = {"servo.pid_position.kp": "60", "servo.pid_position.kd": "2"}  # N·m/turn, N·m·s/turn
# 0.05 rad deep in a wall of 2 N·m/rad, where friction holds the handle.
DEEP = {
    "wall__position": -0.05,
    "wall__stiffness": 2.0,
    "wall__damping": 0.005,
    "trial__start": -0.1,
    "rig__mechanics__motor_coulomb": 0.2,
}
SUPERVISE_TICKS = 5
LIFETIME_US = 20_000
FRICTIONLESS = {
    "rig.mechanics.motor_coulomb": 0.0,
    "controller.loop": "device",
    "controller.arithmetic": "drive",
    "wall.pull": "allow",
    "trial.release_s": 0.02,
    "homing.settle_s": 0.0,
}


def walled(**changes: Any) -> Experiment:
    """Return the knob on a frictionless moteus with its wall on the drive; ``wall__stiffness = 1.0`` sets a key."""
    keys = {name.replace("__", "."): value for name, value in changes.items()}
    return config.override(presets.load_named("moteus-knob"), {**FRICTIONLESS, **keys}, "the test")


class Walled:
    """A session with a wall on the drive.

    Attributes
    ----------
    world, host
        The bridge with its drive, and who supervises.
    angles
        Of the handle, each millisecond (rad), as it truly is.
    """

    def __init__(
        self,
        x: Experiment,
        settings: Mapping[str, str] | None = None,
        *,
        inside: bool = False,
        **parameters: int | float,
    ) -> None:
        """Arm the drive; with `inside` the trial begins at the handle's position, without homing."""
        run = controller.prepare_controller(x)
        self.world = Bridged(rig_model(x), {**GAINS, **(settings or {})})
        self.host = Host(self.world)
        self.ratio = x.rig.encoder.ratio * x.rig.encoder.sign
        self.host.identify()
        values = {**run.parameters, "verified": 1}
        if inside:
            values |= {"home_minimum": -(10**6), "home_maximum": 10**6, "home_target_fraction": 0}
            values |= {"home_target": x.rig.encoder.sign * self.world.drive.motor.count}
        ack = self.host.configure(**{**values, **parameters})
        assert ack.status == 0, ack
        ack = self.host.arm(1, ack.crc)
        assert ack.status == 0, ack
        self.angles: list[float] = []
        self._ticks = 0

    def run(self, seconds: float, *, supervised: bool = True) -> None:
        """Advance time, supervised or without commands; a fault ends it."""
        for _ in range(round(seconds * 1e3)):
            if supervised and self._ticks % SUPERVISE_TICKS == 0:
                self.host.command(mode=m.Mode.SUPERVISE, lifetime_us=LIFETIME_US)
            self._ticks += 1
            self.world.run(0.001)
            for _ in self.host.events(0.0):
                pass
            self.angles.append(2.0 * math.pi * self.world.drive.motor.turns / self.ratio)
            if self.world.bridge.fault and supervised:
                return

    @property
    def state(self) -> m.State:
        return self.host.states[-1]


def within(**changes: Any) -> Walled:
    """Return a session whose handle rests deep in the wall, in the trial."""
    run = Walled(walled(**{**DEEP, **changes}), inside=True)
    run.run(0.012)
    assert run.world.mode == Moteus.stay_within
    assert abs(run.world.torque) > 0.05
    return run
