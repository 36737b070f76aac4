"""The command ``rig experiment plan``: check an experiment before it runs.

`rig.experiments.trials.plan` checks; this file parses options and prints. Nothing may move.
"""

from pathlib import Path
from typing import Any

from rig import config
from rig.cli import _hit_output as hit_output
from rig.cli import options, output
from rig.cli._next_step import name_next
from rig.cli.command import command, option
from rig.config import controller
from rig.core.check import refused
from rig.core.errors import PlanError
from rig.experiments.trials.plan import is_linked, plan_of
from rig.firmware.tick_budget import BOARD


@command()
@options.experiment_options
@options.realtime_option("Plan what runs in real time: the [realtime] variant.")
@options.url_option("no link: only the delays in the file")
@option(
    "--round-trip",
    type=float,
    metavar="S",
    help="Round trip of the link as rig doctor measures it, behind a bridge with that of the drive "
    "(s). [one tick]",
)
@option(
    "--board",
    default=BOARD,
    show_default=True,
    help="Board for which the time of a tick is computed when the law runs on the device.",
)
@options.json_option
def plan(
    file: Path | None,
    preset: str | None,
    realtime: bool,
    url: str | None,
    round_trip: float | None,
    board: str,
    as_json: bool,
    **changed: Any,
) -> None:
    """Check an experiment against its limits before it runs, and list what it will do; nothing moves.

    With --url, --round-trip or --realtime the wall is also checked with an assumed delay of the link; before a run
    the arming gate checks it with the measured delay. Exits with an error if a check refuses the experiment.
    """
    experiment = options.chosen_experiment(file, preset or options.preset_of(url, file))
    changes = options.changes(**changed)
    linked = is_linked(url, realtime=realtime, round_trip_s=round_trip)
    if linked:
        experiment = config.with_realtime(experiment, changes)
    elif changes:
        experiment = config.override(experiment, changes)
    config.check_plugins(experiment, str(file or preset or options.DEFAULT_PRESET))
    planned = plan_of(
        controller.prepare_controller(experiment), linked=linked, round_trip_s=round_trip, board=board
    )
    if as_json:
        output.print_json(planned)
    else:
        output.show([f"checked, nothing moves: {hit_output.headline(experiment)}", *planned.items()])
    if not planned.ok:
        names = ", ".join(check.name for check in refused(planned.checks))
        raise PlanError(
            f"the experiment is refused by the checks {names}",
            remedy="follow the remedy of each of these checks",
        )
    name_next()
