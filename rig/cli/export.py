"""The command ``rig recording export``."""

from pathlib import Path

import click

from rig.cli import _values as values
from rig.cli import options, output
from rig.cli.command import RESULT, command, option
from rig.recording.export import EXPORTERS
from rig.recording.export import export as write


@command()
@click.argument("recording", type=values.RECORDING)
@click.argument("target", type=click.Path(path_type=Path))
@option(
    "--format",
    "kind",
    group=RESULT,
    type=click.Choice(tuple(EXPORTERS)),
    help="Format of TARGET. [from the ending of its name]",
)
@options.overwrite_option
@options.json_option
def export(recording: Path, target: Path, kind: str | None, overwrite: bool, as_json: bool) -> None:
    """Write RECORDING to TARGET for another program, in the format that the ending of TARGET selects.

    csv: all columns, and a JSON file of their units beside the CSV. xy: force of the wall over penetration, as CSV.
    parquet: for data frames. mat: for MATLAB and Octave. mcap: for Foxglove and PlotJuggler (haptic-rig[mcap]).
    """
    path = write(recording, target, kind, overwrite=overwrite)
    if as_json:
        output.print_json({"recording": str(recording), "target": str(path)})
    else:
        click.echo(str(path))
