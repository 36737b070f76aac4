"""The command ``rig recording timing``."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli import _values as values
from rig.cli import options, output
from rig.cli.command import command
from rig.core.present import plain
from rig.recording.timing_report import timing_of


@command()
@click.argument("recording", type=values.RECORDING)
@options.picture_options("Draw it.", default=True, place="RECORDING-timing.png")
@options.json_option
def timing(recording: Path, picture: options.PictureOption, as_json: bool) -> None:
    """Show where the time of each tick in RECORDING went: sampled, received, computed, sent, applied.

    Sampled and applied are times of the device, put on the host's clock by the exchanges of the run; without them only
    the host's share is known.
    """
    found = timing_of(recording)
    picture.draw(
        recording.with_name(f"{recording.stem}-timing"),
        lambda path: found.plot().save(path),
    )
    if as_json:
        output.print_json({**plain(found.summary), **picture.facts()})
        return
    output.show([str(recording), *found.summary.items()])
    if picture.drawn is not None:
        click.echo(f"picture\n  {picture.drawn}")
