"""``rig preset``."""

from __future__ import annotations

import click

from rig import config
from rig.cli import options, output, values
from rig.cli.command import command, option
from rig.config import presets
from rig.core.errors import ConfigError


@command()
@click.argument("name", required=False, type=values.RIG)
@option(
    "--schema",
    is_flag=True,
    help="Print the JSON schema of experiment files, by which editors complete and check.",
)
@options.json_option
def preset(name: str | None, schema: bool, as_json: bool) -> None:
    """List the built-in rigs, or print the file of NAME: commented, with the source of each number.

    For editors (taplo, Even Better TOML in VS Code): rig preset --schema > rig.schema.json, and as the first line of an
    experiment file: #:schema ./rig.schema.json
    """
    if schema:
        if name is not None:
            raise ConfigError(
                f"--schema is the same for every rig: {name} is too much", remedy="leave it out"
            )
        output.print_json(config.json_schema())
    elif name is None:
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
