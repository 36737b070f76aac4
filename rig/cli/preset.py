"""``rig preset``."""

from __future__ import annotations

import click

from rig import config
from rig.cli import options, output
from rig.config import presets


@click.command()
@click.argument("name", required=False)
@options.json_option
def preset(name: str | None, as_json: bool) -> None:
    """List the built-in rigs, or print the file of NAME: commented, with the source of each number."""
    if name is None:
        loaded = {each: presets.load(each) for each in presets.names()}
        if as_json:
            output.print_json({each: experiment.rig.description for each, experiment in loaded.items()})
        else:
            output.print_pairs([(each, experiment.rig.description) for each, experiment in loaded.items()])
    elif as_json:
        output.print_json(config.as_mapping(presets.load(name)))
    else:
        presets.load(name)
        click.echo(presets.text(name), nl=False)
