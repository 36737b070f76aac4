"""A simulated hit for the C law: experiments, and the counts of the host law's run of them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from rig import config
from rig.config import Experiment, controller, presets
from rig.control.step import ControllerState
from rig.core.sample import RowFlag
from sim_backend.bare import trial
from sim_backend.mechanics.plant import DiscretePlant

START = -0.015
FLAGS_OF_THE_HOST = (
    RowFlag.LATE | RowFlag.GAP | RowFlag.NONFINITE | RowFlag.ENERGY | RowFlag.VIOLENT | RowFlag.UNMOVED
)
FLAGS_OF_THE_HOST |= RowFlag.CURRENT_FOLLOWS | RowFlag.CURRENT_DIFFERS | RowFlag.OTHER_CURRENT
SHORT = {"trial.duration_s": 0.06, "trial.release_s": 0.02, "homing.settle_s": 0.01, "verdict.tail_s": 0.02}
DUAL = {"controller.position_rate": 20_000, "controller.velocity_rate": 2_000}
UNIFORM = {"controller.position_rate": 20_000, "controller.velocity_rate": 20_000}


def experiment_of(estimator: str, parameters: Mapping[str, Any], *changes: dict[str, object]) -> Experiment:
    """Return the preset `koul-compliant` with another estimator and further changes."""
    given: dict[str, object] = {"controller.estimator": estimator, "controller.parameters": parameters}
    for change in changes:
        given |= change
    return config.override(presets.load("koul-compliant"), given)


def controller_of(experiment: Experiment, reference_count: int = 0) -> ControllerState:
    quantum = experiment.rig.amplifier.current_quantum_a
    return controller.for_experiment(experiment, current_quantum_a=quantum, reference_count=reference_count)


def counts_of_a_hit(experiment: Experiment) -> np.ndarray:
    """Return the counts of a hit by the host's compiled law with the plant, from rest at `START`."""
    plant = DiscretePlant.build(config.rig_model(experiment), 1.0 / experiment.controller.position_rate)
    return trial.run_trial(controller_of(experiment), plant, START, most_ticks=100_000).counts
