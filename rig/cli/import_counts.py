"""The command ``rig recording import``: convert times and counts of another logger to a recording.

`rig.recording.counts` reads and checks the counts; this file parses options and prints.
"""

from pathlib import Path

import click

from rig.cli import options, output
from rig.cli.command import command, option
from rig.core.present import Row
from rig.core.sample import Motion
from rig.recording.counts import UNITS_S, count_rows, read_counts
from rig.recording.export import export
from rig.recording.origin import counts_facts


@command("import")
@click.argument("file", type=click.Path(path_type=Path))
@option("--count", required=True, help="Column of counts: its name, or its number from 0.")
@option("--time-column", "time", help="Column of times: its name, or its number from 0.")
@option("--time-unit", default="s", show_default=True, type=click.Choice(tuple(UNITS_S)), help="Of times.")
@option("--period", type=float, help="Time between two rows (s), instead of --time-column.")
@option("--width", type=int, help="Width of the counter in bits, if it wraps at fewer than 32.")
@option(
    "--resolution",
    type=float,
    required=True,
    help="Travel per count (rad or m); negative if counts fall while the position rises.",
)
@option(
    "--motion",
    type=click.Choice(("rotary", "linear")),
    default="rotary",
    show_default=True,
    help="Unit of the position: rad or m.",
)
@option("--delimiter", help="Separator of the columns. [semicolon, tab or comma, as in the first line]")
@options.output_option(None, "Recording to write. [FILE.parquet]", "target")
@options.overwrite_option
@options.json_option
def import_counts(
    file: Path,
    count: str,
    time: str | None,
    time_unit: str,
    period: float | None,
    width: int | None,
    resolution: float,
    motion: Motion,
    delimiter: str | None,
    target: Path | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Convert FILE, a CSV of times and counts from another logger, to a recording.

    `rig show`, `rig estimators compare` and `rig estimators tune` accept the recording. Lost samples are detected by
    the times and by empty cells; an interval may differ from whole periods by 10 % of a period.
    """
    recording = read_counts(
        file,
        count=_column(count),
        resolution=resolution,
        time=None if time is None else _column(time),
        time_unit=time_unit,
        period_s=period,
        width=width,
        motion=motion,
        delimiter=delimiter,
    )
    path = export(recording, target or file.with_suffix(".parquet"), "parquet", overwrite=overwrite)
    facts = counts_facts(recording) or {}
    if as_json:
        output.print_json({**facts, "rows": len(recording), "recording": path})
        return
    rows = Row("rows", len(recording), note=f"{recording.time_s[-1]:.6g} s")
    output.print_rows([rows, *count_rows(facts, motion), Row("written", str(path))])


def _column(text: str) -> str | int:
    return int(text) if text.isdecimal() else text
