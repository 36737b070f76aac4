"""The command ``rig device check``: compare four small pushes of the motor with the rig's description.

`rig.experiments.motion.pulse` moves the rig and judges the motion; this file parses options and prints.
"""

import click

from rig import config
from rig.cli import options
from rig.cli._next_step import name_next
from rig.cli.command import command
from rig.cli.output import print_json, print_pairs, show
from rig.core.sample import unit_of
from rig.devices import load_backend
from rig.experiments.motion.pulse import (
    NO_HANDS,
    PUSHES,
    FreeRigRequest,
    check_rig_moves,
    energy_of,
    most_push,
    push_way,
)


@command()
@options.request_options(FreeRigRequest, options.free_rig_options)
@options.json_option
def check(request: FreeRigRequest, as_json: bool) -> None:
    """MOVE THE MOTOR by four small pushes, and compare the motion with the rig's description: direction, size, delay.

    Two pushes in each direction end after a few counts, even if a sign is wrong. Keep hands off the handle. The command
    detects a dead or reversed motor, a dead or swapped encoder and a wrong scale without any current sensor; sessions
    on a real rig run this check before each block. Exits with 12 if the rig does not move as described.
    """
    load_backend(request.url or "sim://")
    x = config.override(request.experiment, request.changes)
    if not as_json:
        effort, position = (unit_of(name, x.rig.motion) for name in ("effort", "position"))
        click.echo(
            f"this moves the motor: {NO_HANDS}; {PUSHES} pushes of at most {most_push(x):.3g} "
            f"{effort}, {push_way(x):.3g} {position} and {1e3 * energy_of(x):.2g} mJ each; the first "
            "run compiles code before the pushes begin",
            err=True,
        )
    found = check_rig_moves(request)
    if as_json:
        print_json(found)
    else:
        show(found.checks)
        print_pairs([("recording", str(found.recording))])
    found.insist()
    name_next()
