"""What `rig zwidth` and `rig kmax` share: which rig, how it is pushed, how stiffness is searched, where results go."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from rig.cli import options
from rig.errors import ConfigError

if TYPE_CHECKING:
    from rig.config import Experiment
    from rig.experiments.ladder import Search

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
            "[as FILE says; a built-in rig: normal]",
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
            default="0.1,0.6",
            show_default=True,
            help="Places of zero in its encoder cell (count).",
        ),
        click.option(
            "--repeats", type=click.IntRange(1, 10_000), default=1, show_default=True, help="Of each climb."
        ),
        click.option("--seed", type=int, help="Of everything random."),
        click.option(
            "--judge",
            "judged",
            type=click.Choice(["true", "recorded"]),
            default="true",
            show_default=True,
            help="Whose signals decide: the simulation's truth, or what a rig would record.",
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
        click.option("--plot/--no-plot", default=True, help="Draw a picture."),
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
) -> Experiment:
    """The experiment to map: a built-in rig is held by a hand unless something else is said."""
    from rig import config  # noqa: PLC0415

    experiment = options.chosen_experiment(file, preset)
    if operator is None and file is None and effort is None:
        operator = "normal"
    changes = options.changes(None, sets, operator=operator, effort=effort, seed=seed)
    return config.override(experiment, changes)


def search(experiment: Experiment, stiffness: str | None, way: Any, ratio: float, span: float) -> Search:
    """The rungs that the options mean."""
    from rig.experiments.ranges import search_for  # noqa: PLC0415

    low, high = (None, None) if stiffness is None else _bounds(stiffness)
    return search_for(experiment, way, ratio=ratio, lowest=low, highest=high, span=span)


def numbers(text: str, option: str) -> tuple[float, ...]:
    """Numbers of ``0,0.5,1`` or, equally spaced, ``0:3.6:17``."""
    import numpy as np  # noqa: PLC0415

    try:
        if ":" in text:
            first, last, count = text.split(":")
            return tuple(np.linspace(float(first), float(last), int(count)).tolist())
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(
            f"{option} {text}: no numbers",
            remedy="write them as 0,0.5,1 or as first:last:count, like 0:3.6:17",
        ) from None


def _bounds(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise ConfigError(
            f"--stiffness {text}: no range", remedy="write it as LOW:HIGH, like 10:1000"
        ) from None
    return low, high


def rates(text: str) -> tuple[int, ...]:
    """Rates of ``1k,20k`` in Hz."""
    from rig.schemes import parse_rates  # noqa: PLC0415

    return tuple(parse_rates(part)[0] for part in text.split(","))
