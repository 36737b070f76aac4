"""Makes ``completion.json`` of the commands: ``python -m rig.cli.completion_table``. A test finds it stale."""

from __future__ import annotations

import json
from typing import Any

import click

from rig import cli
from rig.cli import values
from rig.control import estimators
from rig.core.signals import SIGNALS


def made() -> str:
    """The text of the table, as it is to be."""
    table = {
        "estimators": list(estimators.BUILT_IN),
        "signals": list(SIGNALS),
        "commands": _rows(cli.rig),
    }
    return json.dumps(table, indent=1, ensure_ascii=False) + "\n"


def _rows(group: click.Group) -> dict[str, Any]:
    context = click.Context(group)
    found = {name: group.get_command(context, name) for name in group.list_commands(context)}
    return {name: _row(one) for name, one in found.items() if one is not None}


def _row(one: click.Command) -> dict[str, Any]:
    text = one.get_short_help_str(100)
    if isinstance(one, click.Group):
        return {"help": text, "commands": _rows(one)}
    taken = [parameter for parameter in one.params if isinstance(parameter, click.Option)]
    options_ = {" ".join([*each.opts, *each.secondary_opts]): _kind(each) for each in taken}
    arguments = [[_kind(each), each.nargs] for each in one.params if isinstance(each, click.Argument)]
    return {"help": text, "options": options_, "arguments": arguments}


def _kind(parameter: click.Parameter) -> Any:
    """What a value is: None for a flag, the list of choices, a name in `values.KINDS`, ``path`` or ``text``."""
    if getattr(parameter, "is_flag", False):
        return None
    kind = parameter.type
    if isinstance(kind, click.Choice):
        return list(kind.choices)
    if values.KINDS.get(kind.name) is kind:
        return kind.name
    return "path" if isinstance(kind, click.Path) else "text"


if __name__ == "__main__":
    values.TABLE.write_text(made(), encoding="utf-8")
