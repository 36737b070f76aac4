"""The command ``rig recording timing``."""

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
    """Show the duration of each stage of a tick in RECORDING: sampled, received, computed, sent, applied.

    The times of sampling and applying are the device's, converted to the host's clock by the clock exchanges of the
    run; without exchanges only the host's stages are known.
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
