"""Write ``completion.json`` for the core's commands and for those of each extra (optional package).

Run ``python -m rig.cli.completion_table`` after a change of a command; a test fails if a file is stale. The builder of
documents reads the rows. No command may import this file.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from rig import cli
from rig.cli import _listing as listing
from rig.cli import _values as values
from rig.control import estimators
from rig.core import extras
from rig.experiments.estimation.interface import SIGNALS


def made() -> dict[Path, str]:
    """Return the up-to-date text of each file ``completion.json`` (names and options of all commands), by path."""
    added = extras.added("commands")
    rows = dict(command_rows())
    core = {name: row for name, row in rows.items() if name not in added}
    parts = [("estimators", _json(list(estimators.BUILT_IN))), ("signals", _json(list(SIGNALS)))]
    parts.append(("commands", _lines(core)))
    texts = {
        Path(listing.FILE): "{\n" + ",\n".join(f"{_json(name)}: {part}" for name, part in parts) + "\n}\n"
    }
    for table in extras.tables():
        if own := {name: row for name, row in rows.items() if name in table.rows.get("commands", ())}:
            texts[Path(table.folder, listing.NAME)] = _lines(own) + "\n"
    return texts


def command_rows() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the words that call a command, and its help line and options, in the order of ``--help``."""
    yield from _rows(cli.rig, "")


def _lines(rows: Mapping[str, Any]) -> str:
    return "{\n" + ",\n".join(f"{_json(name)}: {_json(row)}" for name, row in rows.items()) + "\n}"


def _json(part: Any) -> str:
    return json.dumps(part, ensure_ascii=False)


def _rows(group: click.Group, above: str) -> Iterator[tuple[str, dict[str, Any]]]:
    context = click.Context(group)
    for last in group.list_commands(context):
        one, name = group.get_command(context, last), f"{above} {last}".strip()
        if isinstance(one, click.Group):
            yield name, {"help": one.get_short_help_str(120)}
            yield from _rows(one, name)
        elif one is not None:
            yield name, _row(one)


def _row(one: click.Command) -> dict[str, Any]:
    taken = [parameter for parameter in one.params if isinstance(parameter, click.Option)]
    return {
        "help": one.get_short_help_str(120),
        "options": {" ".join([*each.opts, *each.secondary_opts]): _kind(each) for each in taken},
        "arguments": [[_kind(each), each.nargs] for each in one.params if isinstance(each, click.Argument)],
    }


def _kind(parameter: click.Parameter) -> Any:
    """Return how a shell completes an option's value: None (flag), a list of choices, or the name of a kind."""
    if getattr(parameter, "is_flag", False):
        return None
    kind = parameter.type
    if isinstance(kind, click.Choice):
        return list(kind.choices)
    if values.KINDS.get(kind.name) is kind:
        return kind.name
    return "path" if isinstance(kind, click.Path) else "text"


if __name__ == "__main__":
    for path, text in made().items():
        path.write_text(text, encoding="utf-8")
