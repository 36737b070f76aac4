"""Groups of commands that are listed in tables and imported on use, so that ``--help`` is fast.

`rig.cli` builds the tree of commands with it. It must not import a command before the command is called.
"""

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
    """A group of commands of the core and of extras (optional packages), each imported on use.

    Commands of the core work even if an extra cannot be loaded. `titles` has, for each title in ``--help``, the
    commands below it and where to import them from; `words` call the group on the command line, without ``rig``.
    """

    def __init__(self, *arguments: Any, titles: Mapping[str, Table], words: str = "", **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._titles, self._words = titles, words
        self._core = {name: entry for table in titles.values() for name, entry in table.items()}

    @cached_property
    def _listed(self) -> dict[str, list[str]]:
        """Return the names of the commands below each title of ``--help``, also of optional packages (extras)."""
        listed = {title: list(table) for title, table in self._titles.items()}
        for row in extras.added("commands").values():
            above, _, name = row.name.rpartition(" ")
            if above == self._words:
                names = listed.setdefault(row.more.get("title", COMMANDS), [])
                before = row.more.get("before")
                names.insert(names.index(before) if before in names else len(names), name)
        return listed

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands in the order of ``--help``."""
        return [name for names in self._listed.values() for name in names]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return the command `cmd_name`, or create the group of this name; None if the name is unknown."""
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
        """Write the list of commands for ``--help`` without importing them, and the extras that cannot be loaded."""
        for title, names in self._listed.items():
            with formatter.section(title):
                formatter.write_dl([(name, help_line(f"{self._words} {name}".strip())) for name in names])
        if not self._words and (reasons := extras.broken()):
            with formatter.section("Broken extras"):
                formatter.write_dl(list(reasons.items()))
