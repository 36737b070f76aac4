"""The commands ``rig experiment preset`` and ``rig experiment schema``."""

import click

from rig import config
from rig.cli import _values as values
from rig.cli import options, output
from rig.cli.command import command
from rig.config import presets


@command()
@click.argument("name", required=False, type=values.RIG)
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


@command()
@options.json_option
def schema(as_json: bool) -> None:
    """Print the JSON schema of experiment files, for editors.

    For taplo and Even Better TOML in VS Code: rig experiment schema > rig.schema.json, and as the first line of an
    experiment file: #:schema ./rig.schema.json
    """
    output.print_json(config.json_schema())
