"""Command ``rig session export``: write a study's raw data for other programs."""

from pathlib import Path
from typing import Any

import click

from rig.cli import options, output
from rig.cli.command import command
from rig.cli.progress import CountBar
from rig.core.errors import ConfigError
from rig.extras.study.bids import BidsOptions, export_bids
from rig.extras.study.export import export_trials
from rig.extras.study.study import read_study


@command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--bids",
    type=click.Path(path_type=Path),
    metavar="OUT",
    help="Write a BIDS-motion dataset to this new directory.",
)
@click.option(
    "--csv",
    type=click.Path(path_type=Path),
    metavar="OUT",
    help="Write CSV: a file for each trial and a table of the trials.",
)
@click.option(
    "--mat", type=click.Path(path_type=Path), metavar="OUT", help="Write the same for MATLAB and Octave."
)
@click.option(
    "--every",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    metavar="N",
    help="BIDS: keep only every N-th row of a recording, unfiltered.",
)
@click.option(
    "--shift-dates", is_flag=True, help="BIDS: move each participant's dates to begin on 1 January 1925."
)
@click.option("--author", "authors", multiple=True, metavar="NAME", help="BIDS: an author; can be repeated.")
@click.option("--licence", metavar="TEXT", help="BIDS: the licence of the data, like CC0 or CC-BY-4.0.")
@options.across_option
@options.json_option
def export(
    paths: tuple[Path, ...],
    bids: Path | None,
    csv: Path | None,
    mat: Path | None,
    every: int,
    shift_dates: bool,
    authors: tuple[str, ...],
    licence: str | None,
    across: tuple[str, ...],
    as_json: bool,
) -> None:
    """Write the recordings of a study, or of some of its participants, for other programs.

    PATHS are directories of studies or of participants. Trials that do not count are also written, and marked as such;
    recordings that are missing or changed are left out and listed.
    """
    if bids is None and csv is None and mat is None:
        raise ConfigError("no format is given", remedy="give --bids OUT, --csv OUT or --mat OUT")
    with CountBar("reading", plain=as_json) as bar:
        study = read_study(paths, across=across, watch=bar.watch)
    written: dict[str, Any] = {}
    if bids is not None:
        chosen = BidsOptions(every=every, shift_dates=shift_dates, authors=authors, licence=licence)
        with CountBar("writing BIDS", plain=as_json) as bar:
            written["bids"] = export_bids(study, bids, chosen, bar.watch)
    for kind, place in (("csv", csv), ("mat", mat)):
        if place is not None:
            with CountBar(f"writing {kind.upper()}", plain=as_json) as bar:
                written[kind] = export_trials(study, place, kind, bar.watch)
    if as_json:
        output.print_json(written)
        return
    unsaid = [
        option for option, value in (("--author NAME", authors), ("--licence TEXT", licence)) if not value
    ]
    if bids is not None and unsaid:
        click.echo(f"the dataset does not state: {' and '.join(unsaid)}", err=True)
    for message in study.messages:
        click.echo(message)
    for one in written.values():
        click.echo(f"{one.directory}: {one.recordings} recordings")
        for sentence in one.left_out:
            click.echo(f"  left out: {sentence}")
