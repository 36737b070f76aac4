"""Options of the commands that measure a map (which walls are stable or passive): rig, walls, computation, output.

These commands use them as decorators. This file must not measure a map.
"""

from pathlib import Path

from rig import config
from rig.cli import options
from rig.config import Experiment
from rig.core.errors import ConfigError

hit_experiment_options = options.added(
    options.file_argument,
    options.rig_option(),
    options.operator_option(
        "Grip of the simulated hand that pushes (relaxed, normal, firm), or none: the motor pushes, "
        "with the end mass. [as in FILE; a built-in rig: normal in simulation, its own on a device]"
    ),
    options.effort_option,
    options.set_option,
    options.cutoff_option,
    options.seed_option("Seed of all random numbers."),
)
"""Whose walls are hit: the arguments of `chosen`."""

sweep_options = options.added(
    options.workers_option,
    options.scheduler_option,
    options.output_option("maps", "Directory of the maps.", "directory"),
    options.plot_options(),
    options.json_option,
)
"""How a map is computed, and where it is written."""


def chosen(
    file: Path | None,
    preset: str | None,
    operator: str | None,
    effort: float | None,
    seed: int | None,
    sets: tuple[str, ...],
    cutoff: str | None = None,
    *,
    url: str | None = None,
    device: bool = False,
) -> Experiment:
    """Return the experiment whose walls are mapped, from the options of a command.

    Without file, operator and effort a simulated hand holds the handle, unless a `device` or --set chooses the push.
    """
    experiment = options.chosen_experiment(file, preset or options.preset_of(url, file))
    says = any(text.partition("=")[0].strip() == "trial.kind" for text in sets)
    if operator is None and file is None and effort is None and not device and not says:
        operator = "normal"
    changes = options.changes(None, sets, operator=operator, effort=effort, seed=seed, cutoff=cutoff)
    experiment = config.override(experiment, changes)
    if effort is not None and experiment.trial.kind == "human":
        raise ConfigError(
            f"--effort {effort:g} has no effect: a hand pushes ({experiment.operator.grip}), not the motor",
            remedy="add --operator none, or drop --effort",
        )
    return experiment
