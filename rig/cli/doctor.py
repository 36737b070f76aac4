"""The command ``rig doctor``: examine this computer and the link to a device.

`rig.experiments.hits.examine` examines; this file parses options and prints. It must not change the computer.
"""

import click

from rig import config
from rig.cli import options, output
from rig.cli.command import command
from rig.core.errors import PlanError
from rig.core.present import plain
from rig.doctor.interface import rules_for_rigs
from rig.experiments.hits.examine import ExaminationRequest, examine


@command()
@options.request_options(ExaminationRequest, options.experiment_options)
@click.option("--print-udev", is_flag=True, help="Print udev rules for rigs, and exit.")
@options.json_option
def doctor(request: ExaminationRequest, print_udev: bool, as_json: bool) -> None:
    """Examine this computer and the link to a device, and print a remedy for each problem; nothing is changed.

    The computer: permissions, limits, kernel, timers, ports. With --url also the device: its identity, the round trip,
    the highest rate of a loop, the walls that are stable with the measured delay, and whether the wall of the
    experiment may be armed. Remedies are printed as commands and never run.

    Exits with 2 if the wall must not be armed.
    """
    if print_udev:
        click.echo(rules_for_rigs(), nl=False)
        return
    given = click.get_current_context().params
    source = str(given["file"] or given["preset"] or options.DEFAULT_PRESET)
    config.check_plugins(config.override(request.experiment, request.changes), source)
    with output.StatusLine(quiet=as_json) as status:
        found = examine(request, status.on_progress)
    if as_json:
        error = None if found.error is None else output.error_facts(found.error)
        output.print_json({**plain(found), "error": error})
    else:
        output.show(found.items())
    if found.error is not None:
        found.error.reported = as_json
        raise found.error
    if found.armable is False:
        refused = PlanError(
            "the wall of this experiment must not be armed on this computer and link", remedy=found.remedy
        )
        refused.reported = as_json
        raise refused
