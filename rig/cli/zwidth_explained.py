"""``rig zwidth --explain``: where linear theory and hits differ, and why."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from rig.cli import output
from rig.cli.command import option
from rig.cli.progress import SweepBar
from rig.core.errors import ConfigError
from rig.experiments import maps
from rig.experiments.disagreement import DisagreementPlan
from rig.experiments.zwidth import MapPlan
from rig.views.plots.disagreement import draw_disagreement
from rig.views.report.disagreement import paragraph

explain_option = option(
    "--explain",
    "explained",
    is_flag=True,
    help="Hit every wall of the range; where linear theory says otherwise hit it again without friction, quantum, "
    "saturation and loss of contact, one at a time, and say which of them it takes.",
)


def explain(
    plan: MapPlan, directory: Path, plot: str, as_json: bool, *, workers: int | None, scheduler: str | None
) -> None:
    """Compare a map with theory, and print shares, causes and a paragraph."""
    if click.get_current_context().get_parameter_source("way") == ParameterSource.COMMANDLINE:
        raise ConfigError("--explain hits every wall of the range", remedy="drop --search")
    whole = DisagreementPlan(map=plan)
    place = maps.directory_for(whole, directory, "zwidth-explained")
    with SweepBar("columns", unit="ticks", plain=as_json) as bar:
        found = maps.compare_into(whole, place, scheduler=scheduler, workers=workers, watch=bar.watch)
    picture = output.drawn(lambda: draw_disagreement(found, place / f"zwidth.{plot}")) if plot else None
    text = paragraph(found)
    if as_json:
        facts: dict[str, Any] = {**found.as_mapping(), "paragraph": text}
        output.print_json({**facts, "directory": str(place), "picture": picture})
        return
    output.show(found.detailed())
    click.echo(text)
    pairs = [("walls", str(place / found.table_name)), ("summary", str(place / maps.SUMMARY))]
    output.print_pairs([*pairs, ("picture", picture)] if picture else pairs)
