"""A simulated hit for the C law: experiments, the host law's run of them, and the C law in lock-step with the plant."""

import ctypes as ct
from dataclasses import dataclass

import numpy as np

from rig import config
from rig.config import Experiment, controller, presets
from rig.control.judging import TrialSignals, judge
from rig.control.step import ControllerState
from rig.control.verdict import Verdict
from rig.core.sample import Phase, RowFlag
from sim_backend.bare import trial
from sim_backend.mechanics.plant import DiscretePlant, advance
from tests.firmware.law.law_library import LawLibrary

START = -0.015
SHORT = {"trial.duration_s": 0.06, "trial.release_s": 0.02, "homing.settle_s": 0.01, "verdict.tail_s": 0.02}
DUAL = {"controller.position_rate": 20_000, "controller.velocity_rate": 2_000}
UNIFORM = {"controller.position_rate": 20_000, "controller.velocity_rate": 20_000}


def experiment_of(
    estimator: str, parameters: dict[str, float | str], *changes: dict[str, object]
) -> Experiment:
    """Return the preset `koul-compliant` with another estimator and further changes."""
    given: dict[str, object] = {"controller.estimator": estimator, "controller.parameters": parameters}
    for change in changes:
        given |= change
    return config.override(presets.load("koul-compliant"), given)


def controller_of(experiment: Experiment, reference_count: int = 0) -> ControllerState:
    quantum = experiment.rig.amplifier.current_quantum_a
    return controller.for_experiment(experiment, current_quantum_a=quantum, reference_count=reference_count)


def plant_of(experiment: Experiment) -> DiscretePlant:
    return DiscretePlant.build(config.rig_model(experiment), 1.0 / experiment.controller.position_rate)


@dataclass
class Run:
    """Count, resulting current, flags and phase of each tick of a run."""

    counts: np.ndarray
    currents: np.ndarray
    flags: np.ndarray
    phases: np.ndarray

    def verdict(self, experiment: Experiment) -> Verdict:
        """Return the verdict that a recording of this run would get."""
        during = self.phases == Phase.TRIAL
        quantum = controller.effort_quantum(experiment, experiment.rig.amplifier.current_quantum_a)
        position = controller.resolution(experiment) * self.counts[during]
        flags, none = self.flags[during], np.zeros(during.sum(), bool)
        wall = experiment.wall
        signals = TrialSignals(
            tick_s=1.0 / experiment.controller.position_rate,
            resolution=experiment.rig.encoder.resolution,
            position=position,
            velocity=None,
            effort=quantum * self.currents[during],
            penetration=wall.side * (position - wall.position),
            saturated=(flags & RowFlag.SATURATED) != 0,
            late=none,
            lost=np.zeros(len(none), np.int64),
            currents=np.zeros(len(none), np.int64),
            slew_bound=(flags & RowFlag.SLEW_BOUND) != 0,
            overruled=none,
        )
        return judge(signals, config.verdict_thresholds(experiment))


def on_the_host(experiment: Experiment, start: float = START) -> Run:
    """Run the host's compiled law with the plant, from rest at `start`."""
    plant = plant_of(experiment)
    t = trial.run_trial(controller_of(experiment), plant, start, most_ticks=100_000)
    return Run(t.counts, t.currents, t.flags, t.phases)


def in_lock_step(
    law: LawLibrary, experiment: Experiment, parameters: ct.Structure, state: ct.Structure, most_ticks: int
) -> Run:
    """Run the C law and the plant, one tick each in turn, until the law has ended."""
    plant, quantum = plant_of(experiment), experiment.rig.amplifier.current_quantum_a
    quantum_effort = controller.effort_quantum(experiment, quantum)
    body = plant.at_rest(START)
    moving = plant.arguments(body)
    count = advance(moving, 0.0, 0.0)
    rows = np.zeros((4, most_ticks), np.int64)
    active = 0
    for k in range(most_ticks):
        out = law.tick(state, parameters, count, active=active)
        active = out.current
        rows[:, k] = count, out.current, out.flags, out.phase
        if out.phase == Phase.DONE:
            return Run(*rows[:, : k + 1])
        count = advance(moving, out.current * quantum_effort, 0.0)
    return Run(*rows)
