"""Groups of commands that are named in tables and imported on use, so that ``--help`` is quick."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pkgutil import resolve_name
from typing import Any, TypeAlias, cast

import click

from rig.cli._listing import help_line
from rig.core import extras

# Name → module:attribute of a command; or help and table of a group.
Table: TypeAlias = "Mapping[str, str | tuple[str, Table]]"
COMMANDS = "Commands"  # title of a group that has no other


class LazyGroup(click.Group):
    """A group of the core's commands and of those that extras add to it; the core's need no extra's table.

    Parameters
    ----------
    titles
        Title in ``--help`` → the commands under it.
    words
        Words by which the command is called, without ``rig``.
    """

    def __init__(self, *arguments: Any, titles: Mapping[str, Table], words: str = "", **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._titles, self._words = titles, words
        self._core = {name: entry for table in titles.values() for name, entry in table.items()}

    @cached_property
    def _listed(self) -> dict[str, list[str]]:
        """Return title → names, those of extras before the command that they name, else at the end."""
        listed = {title: list(table) for title, table in self._titles.items()}
        for row in extras.added("commands").values():
            above, _, name = row.name.rpartition(" ")
            if above == self._words:
                names = listed.setdefault(row.more.get("title", COMMANDS), [])
                before = row.more.get("before")
                names.insert(names.index(before) if before in names else len(names), name)
        return listed

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names, in the order of ``--help``."""
        return [name for names in self._listed.values() for name in names]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command, or make the group of a table."""
        words = f"{self._words} {cmd_name}".strip()
        entry = self._core.get(cmd_name)
        if isinstance(entry, tuple):
            return LazyGroup(cmd_name, words=words, help=entry[0], titles={COMMANDS: entry[1]})
        if entry is not None:
            return cast("click.Command", resolve_name(entry))
        if words in extras.added("commands") or extras.broken():
            return cast("click.Command", extras.load("commands", words))
        return None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them, and at the top which extras are broken."""
        for title, names in self._listed.items():
            with formatter.section(title):
                formatter.write_dl([(name, help_line(f"{self._words} {name}".strip())) for name in names])
        if not self._words and (reasons := extras.broken()):
            with formatter.section("Broken extras"):
                formatter.write_dl(list(reasons.items()))
