"""Command ``rig theory levant-regions``: draw the gains with which Levant's differentiator converges."""

from pathlib import Path

import click

from rig.cli import options, output
from rig.cli.command import command
from rig.control.estimators.levant_regions import find_crossing
from rig.extras.papers.chawda.levant_plot import draw_levant_regions
from rig.extras.papers.chawda.levant_plot import levant_regions as compute


@command("levant-regions")
@options.picture_options("Draw it.", default=True, place="levant-regions.png")
@options.json_option
def levant_regions(picture: options.PictureOption, as_json: bool) -> None:
    """Draw the gains with which Levant's differentiator converges: α = μ1·C, λ = μ2·√C, by proofs and numerically."""
    computed = compute()
    picture.draw(Path("levant-regions"), lambda path: draw_levant_regions(computed, path))
    if as_json:
        output.print_json({**picture.facts(), **computed.as_mapping()})
        return
    mu1, mu2 = find_crossing()
    place = f"{picture.drawn}: " if picture.drawn else ""
    click.echo(f"{place}HBA and LFBA cross at mu1 = {mu1:.4f}, mu2 = {mu2:.4f}")
