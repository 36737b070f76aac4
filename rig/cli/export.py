"""``rig export``."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli import options, output
from rig.recording.export import export as write


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.argument("target", type=click.Path(path_type=Path))
@click.option(
    "--format", "kind", type=click.Choice(["csv", "parquet", "mat"]), help="[by the ending of TARGET]"
)
@click.option("--overwrite", is_flag=True, help="Replace TARGET if it exists.")
@options.json_option
def export(recording: Path, target: Path, kind: str | None, overwrite: bool, as_json: bool) -> None:
    """Write RECORDING to TARGET as CSV (with a JSON file of units beside it), Parquet or MAT."""
    path = write(recording, target, kind, overwrite=overwrite)
    if as_json:
        output.print_json({"recording": str(recording), "target": str(path)})
    else:
        click.echo(str(path))
