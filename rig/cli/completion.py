"""``rig completion``."""

from __future__ import annotations

import click

from rig.cli import output
from rig.cli.command import command, json_option
from rig.cli.complete import SHELLS, script

_START = {"bash": "~/.bashrc", "zsh": "~/.zshrc", "fish": "~/.config/fish/config.fish"}


@command()
@click.argument("shell", type=click.Choice(SHELLS))
@json_option
def completion(shell: str, as_json: bool) -> None:
    """Print the script by which SHELL completes commands, options, rigs, estimators, schemes, recordings and ports.

    bash and zsh: put eval "$(rig completion bash)" into ~/.bashrc (zsh: ~/.zshrc). fish: rig completion fish | source.
    """
    text = script(shell)
    if as_json:
        output.print_json({"shell": shell, "file": _START[shell], "script": text})
    else:
        click.echo(text)
