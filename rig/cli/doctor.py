"""``rig doctor``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rig import config
from rig.bench.doctor.ports import rules_for_rigs
from rig.cli import options, output
from rig.cli.command import command
from rig.core.errors import PlanError
from rig.core.present import plain
from rig.experiments.examine import ExaminationRequest, examine


@command()
@options.experiment_options
@options.url_option("machine and ports only")
@options.realtime_option("Examine a simulated rig, as a process behind a port.")
@click.option(
    "--seconds",
    type=click.FloatRange(0.1, 600.0),
    default=4.0,
    show_default=True,
    help="How long to measure.",
)
@click.option("--print-udev", is_flag=True, help="Print udev rules for rigs, and do nothing else.")
@options.json_option
def doctor(
    file: Path | None,
    preset: str | None,
    url: str | None,
    realtime: bool,
    seconds: float,
    print_udev: bool,
    as_json: bool,
    **changed: Any,
) -> None:
    """Examine what this machine and a link can do, with the remedy for what they cannot; changes nothing.

    The machine: rights, limits, kernel, timers, ports. With --url the device, too: its identity, the round trip, the
    rate that a loop can have, the walls that are stable with that delay, and whether the wall of the experiment may be
    armed. Commands that remedy something are printed, never run.

    Exits with 2 when the wall must not be armed.
    """
    if print_udev:
        click.echo(rules_for_rigs(), nl=False)
        return
    experiment = options.chosen_experiment(file, preset or options.preset_of(url, file))
    changes = options.changes(**changed)
    config.check_plugins(config.override(experiment, changes), str(file or preset or options.DEFAULT_PRESET))
    question = ExaminationRequest(
        experiment=experiment, changes=changes, url=url, realtime=realtime, seconds=seconds
    )
    with output.StatusLine(quiet=as_json) as status:
        found = examine(question, status.on_progress)
    if as_json:
        error = None if found.error is None else output.error_facts(found.error)
        output.print_json({**plain(found), "error": error})
    else:
        output.show(found.items())
    if found.error is not None:
        found.error.reported = as_json
        raise found.error
    if found.armable is False:
        refused = PlanError("the wall of this experiment must not be armed here", remedy=found.remedy)
        refused.reported = as_json
        raise refused
