"""``rig reproduce``: a paper as one report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from rig.cli import options, output
from rig.cli.progress import SweepBar
from rig.papers.chawda import rigs as chawda_rigs
from rig.papers.chawda.pictures import draw_chawda
from rig.papers.chawda.reproduction import reproduce_chawda
from rig.papers.frame import Reproduction
from rig.papers.koul import rigs as koul_rigs
from rig.papers.koul.pictures import draw_koul
from rig.papers.koul.reproduction import reproduce_koul
from rig.papers.page import write_report
from rig.recording.files import plain_errors

WIDEST = 56  # characters of a cell


@dataclass(frozen=True, slots=True)
class _Paper:
    """How much there is to compute, what computes it, and what draws it."""

    quick: Any
    full: Any
    reproduce: Callable[..., Reproduction]
    draw: Callable[[Any], Mapping[str, bytes]]


PAPERS = {
    "koul": _Paper(koul_rigs.QUICK, koul_rigs.FULL, reproduce_koul, draw_koul),
    "chawda": _Paper(chawda_rigs.QUICK, chawda_rigs.FULL, reproduce_chawda, draw_chawda),
}


@click.command()
@click.argument("paper", type=click.Choice(tuple(PAPERS)))
@click.option(
    "--quick", is_flag=True, help="Coarse grids: every section and claim, in a fraction of the time."
)
@click.option(
    "-o",
    "--output",
    "directory",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("reproductions"),
    show_default=True,
    help="Where the report goes, and the journal to go on from.",
)
@click.option("--workers", type=click.IntRange(1, 1024), help="Threads. [one for each core]")
@options.json_option
def reproduce(paper: str, quick: bool, directory: Path, workers: int | None, as_json: bool) -> None:
    """Reproduce a paper: every figure, a verdict on every claim, its open ideas, as one HTML report.

    koul: dual-rate sampling and Z-width (Koul et al. 2013), in about two minutes. chawda: velocity estimators,
    passivity and fidelity (Chawda et al.), in about three. One that was stopped goes on when the same command is given
    again.
    """
    with plain_errors("make", directory):
        directory.mkdir(parents=True, exist_ok=True)
    known = PAPERS[paper]
    scale = known.quick if quick else known.full
    with SweepBar(f"reproducing {paper}", unit="parts", plain=as_json) as bar:
        found: Reproduction = known.reproduce(
            scale, journal=directory / f"{paper}-{scale.name}.journal", workers=workers, watch=bar.watch
        )
    page, numbers = write_report(found, known.draw(found.results), directory)
    if as_json:
        output.print_json({**found.as_mapping(), "report": str(page), "json": str(numbers)})
        return
    _print(found)
    output.print_pairs(
        [("report", str(page)), ("numbers", str(numbers)), ("computed in", f"{found.seconds:.0f} s")]
    )


def _print(found: Reproduction) -> None:
    click.echo(f"{found.title} ({found.source})")
    for claim in found.claims:
        click.echo(f"  {claim.claim}")
        click.echo(f"    paper {claim.paper}; here {_short(claim.finding.ours)}")
        colour = {"reproduced": "green", "not reproduced": "red"}.get(claim.finding.status, "yellow")
        click.echo(f"    {click.style(_short(claim.finding.verdict), fg=colour, bold=True)}")


def _short(text: str) -> str:
    return text if len(text) <= 2 * WIDEST else text[: 2 * WIDEST - 1].rstrip() + "…"
