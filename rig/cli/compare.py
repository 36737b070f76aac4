"""The command ``rig compare``: one simulated hit with several sampling schemes.

`rig.experiments.hits.compare` simulates them; this file parses options and prints.
"""

from pathlib import Path
from typing import Any

import click

from rig import config
from rig.cli import options, output
from rig.cli._keyword_options import keyword_options
from rig.cli.command import command
from rig.core.present import plain
from rig.experiments.hits import compare as comparing
from rig.experiments.hits.compare import entries_of, refuse_unused
from rig.experiments.trials.plan import stands_for_device


@command()
@options.file_argument
@options.rig_option()
@options.wall_options
@options.rate_option("Position rate, and velocity rate of the dual-rate scheme: 20k/2k.")
@options.estimator_option()
@keyword_options(options.CommandSettings, "loop", "effort", "start", "duration_s")
@options.scheme_option("none, uniform and dual-rate")
@options.set_option
@options.output_option("recordings", "Directory of the picture.", "directory")
@options.plot_options()
@options.json_option
def compare(
    file: Path | None,
    preset: str | None,
    schemes: tuple[str, ...],
    directory: Path,
    plot: str,
    as_json: bool,
    **changed: Any,
) -> None:
    """Compare one simulated hit without damping, with uniform and with dual-rate sampling; nothing is recorded.

    Every sampling scheme gets the same hits, at four offsets of position zero between two counts. FILE is an experiment
    in TOML. On a device, run `rig hit --rate T1/T2` once for each scheme.
    """
    changes = options.changes(**changed)
    refuse_unused(changes)
    experiment = config.override(options.chosen_experiment(file, preset), changes)
    comparison = comparing.compare(experiment, entries_of(experiment, schemes))
    picture = None
    if plot:
        directory.mkdir(parents=True, exist_ok=True)
        picture = output.drawn(comparison, directory / f"{experiment.rig.name}-compare.{plot}")
    if as_json:
        output.print_json({**plain(comparison), "picture": picture})
        return
    output.show(comparison.detailed())
    if experiment.controller.loop == "device":
        click.echo(f"  {stands_for_device(experiment)}")
    if picture is not None:
        output.print_pairs([("picture", picture)])
