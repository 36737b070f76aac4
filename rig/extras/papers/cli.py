"""Command ``rig reproduce``: reproduce a published paper and write one HTML report."""

import textwrap
from pathlib import Path

import click

from rig.cli import options, output
from rig.cli.command import command, option
from rig.cli.progress import SweepBar
from rig.core.errors import ConfigError
from rig.extras.papers import reproduction
from rig.extras.papers.chawda.reproduction import CHAWDA
from rig.extras.papers.cli_impacts import show_impacts
from rig.extras.papers.koul.reproduction import KOUL
from rig.extras.papers.reproduction import Reproduction, draw_into, write_report
from rig.extras.papers.rules import ClaimStatus
from rig.recording.files import plain_errors

WIDEST = 110  # characters of a verdict
COLOURS = {
    ClaimStatus.REPRODUCED: "green",
    ClaimStatus.ONLY_WITH: "yellow",
    ClaimStatus.PARTLY: "yellow",
    ClaimStatus.FOLLOWS: "yellow",
    ClaimStatus.UNDECIDED: "yellow",
    ClaimStatus.NOT: "red",
}
COUNTS = {
    ClaimStatus.REPRODUCED: "reproduced",
    ClaimStatus.ONLY_WITH: "reproduced under a condition",
    ClaimStatus.PARTLY: "reproduced in part",
    ClaimStatus.FOLLOWS: "following from the method",
    ClaimStatus.UNDECIDED: "undecided",
    ClaimStatus.NOT: "not reproduced",
}

PAPERS = {paper.name: paper for paper in (KOUL, CHAWDA)}


@command()
@click.argument("paper", type=click.Choice(tuple(PAPERS)))
@option("--quick", is_flag=True, help="Coarse grids: every section and claim, in a fraction of the time.")
@option(
    "--impacts",
    is_flag=True,
    help="Only figures 7 and 8 of Koul et al.: single impacts, in floating and in fixed point, in a few seconds.",
)
@options.workers_option
@options.output_option(
    "reproductions", "Directory of the report, and of the journal to resume from.", "directory"
)
@options.plot_options("Also write the pictures beside the report.", default=False)
@options.json_option
def reproduce(
    paper: str, quick: bool, impacts: bool, directory: Path, workers: int | None, plot: str, as_json: bool
) -> None:
    """Reproduce a paper: every figure, a verdict on every claim, its open ideas, as one HTML report.

    koul: dual-rate sampling and Z-width (Koul et al. 2013), in about two minutes. chawda: velocity estimators,
    passivity and fidelity (Chawda et al.), in about three. The same command resumes a stopped reproduction.
    """
    if impacts:
        if paper != KOUL.name or quick:
            raise ConfigError(
                "--impacts computes figures 7 and 8 of koul only; it cannot be combined with "
                f"{'--quick' if paper == KOUL.name else f'the paper {paper}'}",
                remedy="run: rig reproduce koul --impacts",
            )
        show_impacts(directory, plot=plot, as_json=as_json)
        return
    with plain_errors("make", directory):
        directory.mkdir(parents=True, exist_ok=True)
    known = PAPERS[paper]
    scale = known.quick if quick else known.full
    with SweepBar(f"reproducing {paper}", unit="parts", plain=as_json) as bar:
        found = reproduction.reproduce(
            known,
            scale,
            journal=directory / f"{paper}-{scale.name}.journal",
            workers=workers,
            watch=bar.watch,
        )
    page, numbers = write_report(found, directory, output.no_picture)
    pictures = draw_into(found, directory, plot, output.no_picture) if plot else {}
    if as_json:
        files = {"report": page, "json": numbers, "pictures": pictures}
        output.print_json({**found.as_mapping(), **files})
        return
    _print(found)
    pairs = [("report", str(page)), ("numbers", str(numbers)), ("computed in", f"{found.seconds:.0f} s")]
    output.print_pairs([*pairs, *((name, str(path)) for name, path in pictures.items())])


def _print(found: Reproduction) -> None:
    click.echo(f"{found.title} ({found.source})")
    counts = [f"{found.count(status)} {name}" for status, name in COUNTS.items()]
    click.echo(f"{len(found.claims)} claims: {', '.join(counts)}")
    for claim in found.claims:
        verdict = textwrap.shorten(claim.verdict, WIDEST, placeholder=" …")
        click.echo(f"  {claim.claim}\n    {click.style(verdict, fg=COLOURS[claim.status], bold=True)}")
