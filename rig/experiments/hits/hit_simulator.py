"""Simulate hits on one rig with one sampling scheme, without the messages between host and device.

Maps, papers and the simulated hand of a session's plan call this module. It opens no device and records nothing. The
trajectory of a hit equals, to the last bit, the trajectory that the loop over the byte link produces.
"""

from dataclasses import asdict, replace

import numpy as np

from rig import config, devices
from rig.config import Experiment, controller
from rig.control.laws import Law
from rig.core.model import RigModel
from rig.devices.simulated import SimulatedHit

# Time for homing (s) besides settling: the handle starts within homing's tolerance, so that homing is short.
HOMING_ALLOWANCE_S = 0.5


class HitSimulator:
    """A simulated rig that hits virtual walls of any stiffness and damping.

    Parameters
    ----------
    experiment
        Rig, controller, trial, thresholds and wall; the wall's stiffness and damping are ignored. The seed determines
        where the handle starts, within homing's tolerance, and the tremor of a simulated hand.
    law
        Control law to run instead of the law that the experiment names.
    rig
        Rig to simulate instead of the experiment's; the controller keeps the experiment's values, which are then wrong.

    Attributes
    ----------
    limits
        Thresholds of the verdict, in the units of the rig.
    start
        Position at which the handle rests before each hit (rad or m).
    """

    def __init__(
        self, experiment: Experiment, *, law: Law | None = None, rig: RigModel | None = None
    ) -> None:
        trial, homing = experiment.trial, experiment.homing
        tick_s = 1.0 / experiment.controller.position_rate
        longest_s = homing.settle_s + HOMING_ALLOWANCE_S + trial.baseline_s + trial.duration_s + 2 * tick_s
        # The verdict uses the push only: simulating the ramp down after the push would cost time.
        experiment = replace(experiment, trial=replace(trial, release_s=tick_s))
        self._wall = experiment.wall
        # Plant, filters and scratch memory are prepared once: a hit then costs what its ticks cost.
        self._template = controller.for_experiment(
            experiment, current_quantum_a=experiment.rig.amplifier.current_quantum_a, law=law
        )
        self.limits = config.verdict_thresholds(experiment)
        model = rig or config.rig_model(experiment)
        self._rig = devices.simulated_rig()(model, tick_s, self.limits, round(longest_s / tick_s))
        # A controller that is wrong about the encoder homes to another position.
        scale = model.encoder.resolution / experiment.rig.encoder.resolution
        self.start = start_of(experiment) * scale

    def hit(self, stiffness: float, damping: float) -> SimulatedHit:
        """Simulate one hit on a wall (SI units); return its ripples and more, by sampled and by true signals."""
        wall = asdict(replace(self._wall, stiffness=stiffness, damping=damping))
        return self._rig.hit(self._template.fresh(wall), self.start)


def start_of(experiment: Experiment) -> float:
    """Return the handle's start (rad or m): `trial.start` plus a random part (by the seed) of homing's tolerance."""
    spread = experiment.homing.tolerance_counts * experiment.rig.encoder.resolution / 2.0
    return experiment.trial.start + spread * float(
        np.random.default_rng(experiment.trial.seed).uniform(-1.0, 1.0)
    )
