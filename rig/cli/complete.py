"""Reply to a shell's requests for completion.

A shell must not wait, and most commands import numpy and a compiler, so the replies come from files named
``completion.json``, which `rig.cli.completion_table` writes. `rig.__main__` calls this file before all other imports.
It must not import a command.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import click
from click.shell_completion import BashComplete, FishComplete, ShellComplete, ZshComplete, split_arg_string

from rig.cli import _values as values
from rig.cli._listing import commands

ASKED = "_RIG_COMPLETE"  # variable by which a shell's script asks


# bash takes : and = for ends of words, as in sim://… and dual:20k/2k. So it sends the line, and of an answer it is
# given what follows the last of them.
_BASH = """\
%(complete_func)s() {
    local IFS=$'\\n' line=${COMP_LINE:0:$COMP_POINT} kind value word begun
    word=${line##* }
    begun=${word%%"${word##*["$COMP_WORDBREAKS"]}"}
    [[ $begun == --*=* ]] && begun=${begun#*=}
    for value in $(env COMP_WORDS="$line" %(complete_var)s=bash_complete $1); do
        kind=${value%%%%,*} value=${value#*,}
        if [[ $kind != plain ]]; then
            compopt -o default
        elif [[ $value == *[/:=] ]]; then
            compopt -o nospace
            COMPREPLY+=("${value#"$begun"}")
        else
            COMPREPLY+=("${value#"$begun"}")
        fi
    done
}
complete -o nosort -F %(complete_func)s %(prog_name)s
"""


class Bash(BashComplete):
    """Completion of ``rig`` commands for bash, from the whole command line."""

    source_template = _BASH

    def get_completion_args(self) -> tuple[list[str], str]:
        """Return the words before the last word of the command line, and the typed part of the last word."""
        line = os.environ["COMP_WORDS"]
        words = split_arg_string(line)[1:]
        return (words, "") if line.endswith(" ") else (words[:-1], words[-1] if words else "")


SHELLS: dict[str, type[ShellComplete]] = {"bash": Bash, "zsh": ZshComplete, "fish": FishComplete}


def answer(instruction: str) -> int:
    """Print the reply to a shell's completion request and return the exit code.

    `instruction` is click's: ``bash_source`` requests the completion script, and that script requests
    ``bash_complete``. The words of the command line are in environment variables, which the script sets.
    """
    shell, _, what = instruction.partition("_")
    known = SHELLS.get(shell)
    if known is None or what not in ("source", "complete"):
        return 1
    asked = known(tree(commands()), {}, "rig", ASKED)
    click.echo(asked.source_template % asked.source_vars() if what == "source" else asked.complete())
    return 0


def tree(rows: Mapping[str, Any]) -> click.Group:
    """Return a tree of commands that have options but do nothing, from the rows of ``completion.json``."""
    groups = {"": click.Group("rig")}
    for name, row in rows.items():
        above, _, last = name.rpartition(" ")
        if "options" in row:
            groups[above].add_command(_command(last, row))
        else:
            groups[name] = click.Group(last, short_help=row["help"])
            groups[above].add_command(groups[name])
    return groups[""]


def _command(name: str, row: Mapping[str, Any]) -> click.Command:
    options_ = [_option(words, kind) for words, kind in row["options"].items()]
    arguments = [_argument(number, *taken) for number, taken in enumerate(row["arguments"])]
    return click.Command(name, params=[*options_, *arguments], short_help=row["help"])


def _option(words: str, kind: Any) -> click.Option:
    names = words.split()
    return (
        click.Option(names, is_flag=True)
        if kind is None
        else click.Option(names, type=_type(kind), multiple=True)
    )


def _argument(number: int, kind: Any, count: int) -> click.Argument:
    return click.Argument([f"argument_{number}"], type=_type(kind), nargs=count, required=False)


def _type(kind: Any) -> click.ParamType[Any]:
    if isinstance(kind, list):
        return click.Choice(kind)
    if kind == "path":
        return click.Path()
    return values.KINDS.get(kind, click.STRING)
