"""What commands that map share: whose walls are hit, and which; how a map is computed, and where it is written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rig import config
from rig.cli import options
from rig.cli.command import option
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.experiments.ranges import hit_plan, schemes_for, search_for
from rig.experiments.searches import Way, bounds_of, numbers_of
from rig.experiments.zwidth import MapPlan

WAYS = ("ladder", "bisection", "grid")

walls_hit_options = options.added(
    options.file_argument,
    options.rig_option(),
    options.operator_option(
        "Who pushes: a simulated hand (relaxed, normal, firm), or none: the motor, with the end mass. "
        "[as FILE says; a built-in rig: normal in simulation, as it says on a device]"
    ),
    options.effort_option,
    options.set_option,
    options.walls_options(
        "Range of stiffness, FROM:TO. [up to where the push rests trial.minimum_rest_counts deep]",
        "Dampings. [17, to beyond the limit of the linear theory]",
    ),
    options.scheme_option(
        "the experiment's and the uniform ones of its rates; -B 0: uniform, 100 Hz to 50 kHz"
    ),
    option("--ratio", type=float, default=1.06, show_default=True, help="Between two stiffnesses."),
    option("--offsets", help="Places of zero in its encoder cell (count). [0.1,0.6; a device has one]"),
    options.repeats_option("Of each series.", default=1, show_default=True),
    options.judge_option,
    options.seed_option("Of everything random."),
)
"""Whose walls are hit, and which: the arguments of `plan_hits`."""

search_option = option(
    "--search", "way", type=click.Choice(WAYS), default="ladder", show_default=True, help="How K is searched."
)

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
    device: bool = False,
) -> Experiment:
    """Return the experiment to map: in simulation a built-in rig is held by a hand unless something else is given."""
    experiment = options.chosen_experiment(file, preset)
    says = any(text.partition("=")[0].strip() == "trial.kind" for text in sets)
    if operator is None and file is None and effort is None and not device and not says:
        operator = "normal"
    changes = options.changes(None, sets, operator=operator, effort=effort, seed=seed, cutoff=cutoff)
    experiment = config.override(experiment, changes)
    if effort is not None and experiment.trial.kind == "human":
        raise ConfigError(
            f"--effort {effort:g}: a person pushes here ({experiment.operator.grip}), not the motor",
            remedy="say --operator none too, or drop --effort",
        )
    return experiment


def plan_hits(
    *,
    stiffness: str | None,
    damping: str | None,
    schemes: tuple[str, ...],
    ratio: float,
    offsets: str | None,
    repeats: int,
    judged: Any,
    way: Way = "ladder",
    device: bool = False,
    realtime: bool = False,
    **rig: Any,
) -> MapPlan:
    """Return the plan of a map that `walls_hit_options` mean."""
    experiment = chosen(**rig, device=device)
    if realtime:
        experiment = config.with_realtime(experiment)
    dampings = None if damping is None else numbers_of(damping, "--damping")
    parsed = [Scheme.parse(text) for text in schemes]
    compared = schemes_for(experiment, parsed, dampings, on_device=device)
    low, high = (None, None) if stiffness is None else bounds_of(stiffness, "--stiffness")
    return hit_plan(
        experiment,
        compared,
        dampings=dampings,
        search=search_for(
            experiment, way, ratio=ratio, lowest=low, highest=high, schemes=compared, on_device=device
        ),
        offsets=None if offsets is None else numbers_of(offsets, "--offsets"),
        repeats=repeats,
        judged=judged,
        on_device=device,
    )
