"""Groups of commands that are named in a table and imported on use, so that ``--help`` is quick."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pkgutil import resolve_name
from typing import Any, TypeAlias, cast

import click

from rig.cli.listing import listing

# Name → module:attribute of a command; or help and table of a group.
Table: TypeAlias = "Mapping[str, str | tuple[str, Table]]"


class LazyGroup(click.Group):
    """A group whose commands stand in a table; ``completion.json`` has their lines for ``--help``.

    Parameters
    ----------
    words
        By which it is called, without ``rig``.
    table
        See `Table`.
    titles
        Title → names that ``--help`` lists under it; one title for all of them unless given.
    """

    def __init__(
        self,
        *arguments: Any,
        table: Table,
        words: str = "",
        titles: Mapping[str, Iterable[str]] | None = None,
        **more: Any,
    ) -> None:
        super().__init__(*arguments, **more)
        self._words, self._table = words, table
        self._titles = {"Commands": table} if titles is None else titles

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names, in the order of the table."""
        return list(self._table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command, or make the group of a table."""
        entry = self._table.get(cmd_name)
        if isinstance(entry, tuple):
            return LazyGroup(
                cmd_name, words=f"{self._words} {cmd_name}".strip(), help=entry[0], table=entry[1]
            )
        return None if entry is None else cast("click.Command", resolve_name(entry))

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        known = listing()["commands"]
        for title, names in self._titles.items():
            with formatter.section(title):
                formatter.write_dl([(n, known[f"{self._words} {n}".strip()]["help"]) for n in names])
