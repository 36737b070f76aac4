"""``rig check``."""

from __future__ import annotations

from pathlib import Path

import click

from rig import config
from rig.cli import options
from rig.cli.output import print_json, print_pairs, show
from rig.core.sample import unit_of
from rig.devices import load_backend
from rig.experiments.identify_motions import most_push, push_way
from rig.experiments.motion_run import FreeRigRequest
from rig.experiments.pulse import NO_HANDS, PUSHES, check_rig_moves, energy_of


@click.command()
@click.argument("file", required=False, type=click.Path(path_type=Path))
@click.option("--rig", "preset", metavar="NAME", help="Built-in rig, when no FILE is given.")
@click.option(
    "--set", "sets", multiple=True, metavar="KEY=VALUE", help="Any other key: --set rig.limits.speed=5."
)
@click.option("--url", help="Device: serial:///dev/ttyACM0, sim://. [simulates the rig in this process]")
@click.option("--verified", is_flag=True, help="On a real rig: a push of the wrong sign can hurt nothing.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("recordings"),
    show_default=True,
    help="Directory of the recording.",
)
@options.json_option
def check(
    file: Path | None,
    preset: str | None,
    sets: tuple[str, ...],
    url: str | None,
    verified: bool,
    output: Path,
    as_json: bool,
) -> None:
    """Send a rig a torque pulse, and compare its motion with the described one: direction, size, delay.

    Four small pushes, two each way, that end after a few counts whatever the signs are. Keep hands off the handle. It
    finds a dead or reversed motor, a dead or swapped encoder and a wrong scale without any current sensor; sessions on
    a real rig do the same before each block. Ends with 12 when the rig does not move as described.
    """
    experiment = options.chosen_experiment(file, preset or options.preset_of(url, file))
    load_backend(url or "sim://")
    request = FreeRigRequest(
        experiment=experiment, url=url, changes=options.changes(None, sets), verified=verified, output=output
    )
    x = config.override(request.experiment, request.changes)
    if not as_json:
        effort, position = (unit_of(name, x.rig.motion) for name in ("effort", "position"))
        click.echo(
            f"{NO_HANDS}; {PUSHES} pushes of at most {most_push(x):.3g} {effort}, {push_way(x):.3g} {position} and "
            f"{1e3 * energy_of(x):.2g} mJ each",
            err=True,
        )
    found = check_rig_moves(request)
    if as_json:
        print_json(found)
    else:
        show(found.checks)
        print_pairs([("recording", str(found.recording))])
    found.insist()
