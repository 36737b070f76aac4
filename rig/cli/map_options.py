"""What `rig zwidth` and `rig kmax` share: which rig, how it is pushed, how stiffness is searched, where results go."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from rig import config
from rig.cli import options
from rig.cli.command import option
from rig.config import Experiment
from rig.config.schemes import Scheme, parse_rates
from rig.core.errors import ConfigError
from rig.experiments.impedance import Judging
from rig.experiments.ranges import search_for
from rig.experiments.searches import Search, bounds_of

WAYS = ("ladder", "bisection", "grid")


map_options = options.added(
    options.file_argument,
    options.rig_option(),
    options.operator_option(
        "Who pushes: a simulated hand (relaxed, normal, firm), or none: the motor, with the end mass. "
        "[as FILE says; a built-in rig: normal in simulation, as it says on a device]"
    ),
    options.effort_option,
    options.set_option,
    option(
        "--search",
        "way",
        type=click.Choice(WAYS),
        default="ladder",
        show_default=True,
        help="How K is searched.",
    ),
    option("--ratio", type=float, default=1.06, show_default=True, help="Between two stiffnesses."),
    option("--offsets", help="Places of zero in its encoder cell (count). [0.1,0.6; a device has one]"),
    options.repeats_option("Of each series.", default=1, show_default=True),
    options.judge_option,
    options.seed_option("Of everything random."),
    options.workers_option,
    option("--scheduler", metavar="tcp://HOST:PORT", help="Run on a Dask cluster (haptic-rig[cluster])."),
    options.output_option("maps", "Directory of the maps.", "directory"),
    options.plot_options(),
    options.json_option,
)
"""What every map has."""


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
    """The experiment to map: in simulation a built-in rig is held by a hand unless something else is said."""
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


def search(
    experiment: Experiment,
    stiffness: str | None,
    way: Any,
    ratio: float,
    span: float,
    *,
    schemes: Sequence[Scheme] = (),
    device: bool = False,
) -> Search:
    """The rungs that the options mean."""
    low, high = (None, None) if stiffness is None else bounds_of(stiffness, "--stiffness")
    return search_for(
        experiment, way, ratio=ratio, lowest=low, highest=high, span=span, schemes=schemes, on_device=device
    )


def judging(judged_band: str | None, **thresholds: float | None) -> Judging:
    """What `options.judging_options` mean."""
    given: dict[str, Any] = {name: value for name, value in thresholds.items() if value is not None}
    found = None if judged_band is None else options.band(judged_band, "--judged-band")
    return Judging(band_hz=found, **given)


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
