"""Command ``rig theory disagreement``: compare linear theory with simulated hits."""

from pathlib import Path
from typing import Any

import click

from rig.cli import map_options, output
from rig.cli.command import command
from rig.cli.options import gathered_options
from rig.cli.progress import SweepBar
from rig.experiments.mapping import interface as maps
from rig.experiments.mapping.interface import MapRequest
from rig.extras.papers.disagreement.disagreement import DisagreementPlan, compare_into
from rig.extras.papers.disagreement.report import paragraph


@command()
@map_options.hit_experiment_options
@gathered_options(
    MapRequest, "walls", "stiffness", "damping", "schemes", "ratio", "offsets", "repeats", "judged"
)
@map_options.sweep_options
def disagreement(
    walls: MapRequest,
    workers: int | None,
    scheduler: str | None,
    directory: Path,
    plot: str,
    as_json: bool,
    **rig: Any,
) -> None:
    """Hit every wall of a range, and report where linear theory and hits differ, and why.

    Walls that differ are hit again without friction, quantisation, saturation or loss of contact, one at a time and
    together, to find the cause. Prints a paragraph to cite, and draws a picture.
    """
    plan = DisagreementPlan(map=walls.plan(map_options.chosen(**rig)))
    place = maps.directory_for(plan, directory, "disagreement")
    with SweepBar("columns", unit="ticks", plain=as_json) as bar:
        found = compare_into(plan, place, scheduler=scheduler, workers=workers, watch=bar.watch)
    picture = output.drawn(found, place / f"disagreement.{plot}") if plot else None
    text = paragraph(found)
    if as_json:
        facts = {"paragraph": text, "directory": str(place), "picture": picture}
        output.print_json({**found.as_mapping(), **facts})
        return
    output.show(found.detailed())
    click.echo(text)
    pairs = [("walls", str(place / found.table_name)), ("summary", str(place / maps.SUMMARY))]
    output.print_pairs([*pairs, ("picture", picture)] if picture else pairs)
