"""What `rig zwidth` and `rig kmax` share: which rig, how it is pushed, how stiffness is searched, where results go."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from rig import config
from rig.cli import options
from rig.config import Experiment
from rig.config.schemes import parse_rates
from rig.core.errors import ConfigError
from rig.experiments.ranges import search_for
from rig.experiments.searches import Search, bounds_of

F = TypeVar("F", bound=Callable[..., Any])

WAYS = ("ladder", "bisection", "grid")


def map_options(command: F) -> F:
    """Add the options that every map has."""
    added = [
        click.argument("file", required=False, type=click.Path(path_type=Path)),
        click.option(
            "--rig",
            "preset",
            metavar="NAME",
            help=f"Built-in rig, when no FILE is given. [{options.DEFAULT_PRESET}]",
        ),
        click.option(
            "--operator",
            metavar="GRIP",
            help="Who pushes: relaxed, normal, firm (a simulated hand), or none (the motor, with the end mass). "
            "[as FILE says; a built-in rig: normal in simulation, as it says on a device]",
        ),
        click.option("--effort", type=float, help="Constant push, with --operator none (N·m or N)."),
        click.option(
            "-K",
            "--stiffness",
            metavar="LOW:HIGH",
            help="Range of stiffness. [up to where the push rests trial.minimum_rest_counts deep]",
        ),
        click.option("--search", "way", type=click.Choice(WAYS), default="ladder", show_default=True),
        click.option("--ratio", type=float, default=1.06, show_default=True, help="Between two stiffnesses."),
        click.option(
            "--offsets",
            help="Places of zero in its encoder cell (count). [0.1,0.6; a device has one]",
        ),
        click.option(
            "--repeats", type=click.IntRange(1, 10_000), default=1, show_default=True, help="Of each climb."
        ),
        click.option("--seed", type=int, help="Of everything random."),
        click.option(
            "--judge",
            "judged",
            type=click.Choice(["true", "recorded"]),
            help="Whose signals decide: the simulation's truth, or what a rig records. [true; on a device: recorded]",
        ),
        click.option(
            "--set", "sets", multiple=True, metavar="KEY=VALUE", help="Any other key of the experiment."
        ),
        click.option("--workers", type=click.IntRange(1, 1024), help="Threads. [one for each core]"),
        click.option(
            "--scheduler", metavar="tcp://HOST:PORT", help="Run on a Dask cluster (haptic-rig[cluster])."
        ),
        click.option(
            "-o",
            "--output",
            "directory",
            type=click.Path(path_type=Path),
            default=Path("maps"),
            show_default=True,
        ),
        options.plot_options(),
        options.json_option,
    ]
    for option in reversed(added):
        command = option(command)
    return command


def chosen(
    file: Path | None,
    preset: str | None,
    operator: str | None,
    effort: float | None,
    seed: int | None,
    sets: tuple[str, ...],
    *,
    device: bool = False,
) -> Experiment:
    """The experiment to map: in simulation a built-in rig is held by a hand unless something else is said."""
    experiment = options.chosen_experiment(file, preset)
    says = any(text.partition("=")[0].strip() == "trial.kind" for text in sets)
    if operator is None and file is None and effort is None and not device and not says:
        operator = "normal"
    changes = options.changes(None, sets, operator=operator, effort=effort, seed=seed)
    experiment = config.override(experiment, changes)
    if effort is not None and experiment.trial.kind == "human":
        raise ConfigError(
            f"--effort {effort:g}: a person pushes here ({experiment.operator.grip}), not the motor",
            remedy="say --operator none too, or drop --effort",
        )
    return experiment


def search(
    experiment: Experiment,
    stiffness: str | None,
    way: Any,
    ratio: float,
    span: float,
    *,
    device: bool = False,
) -> Search:
    """The rungs that the options mean."""
    low, high = (None, None) if stiffness is None else bounds_of(stiffness, "--stiffness")
    return search_for(experiment, way, ratio=ratio, lowest=low, highest=high, span=span, on_device=device)


def rates(text: str) -> tuple[int, ...]:
    """Rates of ``1k,20k`` in Hz."""
    try:
        pairs = [parse_rates(part) for part in text.split(",")]
    except ConfigError as error:
        raise ConfigError(f"--rates {text!r}: {error.message}", remedy="write them as 1k,20k") from None
    if any(fast != slow for fast, slow in pairs):
        raise ConfigError(
            f"--rates {text!r}: at B = 0 nothing is damped, so there is no second rate",
            remedy="write them as 1k,20k",
        )
    return tuple(fast for fast, _ in pairs)
