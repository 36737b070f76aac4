"""Groups of commands that are named in a table and imported on use, so that ``--help`` is quick."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pkgutil import resolve_name
from typing import Any, cast

import click

from rig.cli.command import Group


class LazyGroup(Group):
    """A group whose commands stand in a table.

    Parameters
    ----------
    table
        Command → module:attribute, and the line that ``--help`` shows without importing it.
    groups
        Titles under which ``--help`` lists the commands; one unless given.
    """

    def __init__(
        self,
        *arguments: Any,
        table: Mapping[str, tuple[str, str]],
        groups: Mapping[str, Iterable[str]] | None = None,
        **more: Any,
    ) -> None:
        super().__init__(*arguments, **more)
        self._table = table
        self._groups = {"Commands": table} if groups is None else groups

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names, in the order of the table."""
        return list(self._table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name not in self._table:
            return None
        return cast("click.Command", resolve_name(self._table[cmd_name][0]))

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        for title, names in self._groups.items():
            with formatter.section(title):
                formatter.write_dl([(name, self._table[name][1]) for name in names])
