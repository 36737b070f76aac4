"""Print the output of commands: aligned lines for people, JSON for programs, progress on standard error.

Commands of the core and of extras print only through this file. It must not compute a result.
"""

import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Self, cast

import click

from rig.cli.command import quiet as told_quiet
from rig.core.check import Check, Outcome
from rig.core.errors import RigError
from rig.core.present import Item, Row, Table, plain
from rig.core.shown import Drawn

_COLOURS = {"stable": "green", "limit cycle": "yellow", "unstable": "red", "invalid": "magenta"}
_ARGUMENT = re.compile(r"`([a-z]+(?:_[a-z]+)*)`")
_MARKS = {
    Outcome.OK: ("ok", "green"),
    Outcome.WARNING: ("!!", "yellow"),
    Outcome.REFUSED: ("no", "red"),
    Outcome.SKIPPED: ("--", "cyan"),
}


def print_json(result: Any) -> None:
    """Print a result as JSON in UTF-8; remedies in it name options of the command instead of arguments."""
    text = json.dumps(_remedies_for_terminal(plain(result)), ensure_ascii=False, indent=2)
    takes_bytes = hasattr(sys.stdout, "buffer")  # not where a program redirected it into a string
    # \udcff of a file's name is JSON.
    click.echo(text.encode("utf-8", "backslashreplace") if takes_bytes else text)


def _remedies_for_terminal(value: Any) -> Any:
    if isinstance(value, list):
        return [_remedies_for_terminal(one) for one in value]
    if not isinstance(value, dict):
        return value
    found = {key: _remedies_for_terminal(one) for key, one in value.items()}
    remedy = found.get("remedy")
    return {**found, "remedy": _with_options(remedy)} if isinstance(remedy, str) else found


def for_terminal(text: str) -> str:
    """Return a message for a terminal: names of arguments become options, control characters are escaped."""
    return "".join(
        one if one.isprintable() or one in "\n\t" else ascii(one)[1:-1] for one in _with_options(text)
    )


def _with_options(text: str) -> str:
    return _ARGUMENT.sub(lambda named: "--" + named[1].replace("_", "-"), text)


def show(items: Iterable[Item]) -> None:
    """Print headings, rows, tables and checks; consecutive rows are aligned."""
    for kind, some in groupby(items, type):
        if kind is Row:
            print_rows(cast("list[Row]", list(some)))
            continue
        for item in some:
            match item:
                case Table():
                    print_table(item)
                case Check():
                    print_check(item)
                case _:
                    click.echo(item)


def print_rows(rows: Sequence[Row]) -> None:
    """Print a line with label and text for each row, aligned in columns; verdicts are coloured."""
    print_pairs([(row.label, _in_colour(row)) for row in rows])


def _in_colour(row: Row) -> str:
    return (
        row.text.replace(str(row.value), coloured(str(row.value)), 1) if row.value in _COLOURS else row.text
    )


def print_pairs(pairs: Sequence[tuple[str, str]]) -> None:
    """Print a line with name and value for each pair, aligned in columns."""
    width = max((len(name) for name, _ in pairs), default=0)
    for name, value in pairs:
        click.echo(f"  {name:<{width}}  {value}")


def print_table(table: Table) -> None:
    """Print a table with its caption as heading; words are aligned left, numbers right."""
    lines = [list(table.head), *table.cells]
    widths = [max(len(line[i]) for line in lines) for i in range(len(table.head))]
    if table.caption:
        click.echo(table.caption)
    for line in lines:
        aligned = (
            cell.ljust(w) if i < table.words else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(line, widths, strict=True))
        )
        click.echo("  " + "  ".join(aligned).rstrip())


def print_check(check: Check) -> None:
    """Print a check: pass or fail, name and text; if it is not passed, also why it matters and the remedy."""
    mark, colour = _MARKS[check.outcome]
    click.echo(f"  {click.style(mark, fg=colour)} {check.name}: {for_terminal(check.text)}")
    if check.outcome is not Outcome.OK:
        for line in (check.why, check.remedy):
            if line:
                click.echo(f"       {for_terminal(line)}")


def coloured(kind: str) -> str:
    """Return a verdict, such as ``stable``, with the terminal codes of its colour."""
    return click.style(kind, fg=_COLOURS.get(kind), bold=True)


def drawn(result: Drawn, path: Path) -> str | None:
    """Draw a result into a file and return its path; if this fails, report the error and return None."""
    return drawn_by(lambda: result.plot().save(path))


def drawn_by(draw: Callable[[], Path]) -> str | None:
    """Call `draw` and return the path of its picture; if this fails, report the error and return None."""
    try:
        return str(draw())
    except Exception as error:  # a picture has many ways to fail, and its data are on disk
        no_picture(error)
        return None


def no_picture(error: Exception, name: str = "") -> None:
    """Report on standard error why a picture was not drawn; `name` is the picture's name."""
    click.echo(f"rig: no picture{name and f' {name}'}: {error}", err=True)


def note(text: str) -> None:
    """Print a remark, such as the next step, on standard error; ``-q`` suppresses it."""
    if not told_quiet():
        click.echo(text, err=True)


def on_terminal() -> bool:
    """Return True if progress can be drawn: standard error is a terminal that moves its cursor, without ``-q``."""
    is_terminal = sys.stderr is not None and sys.stderr.isatty()
    return not told_quiet() and is_terminal and os.environ.get("TERM") not in ("dumb", "unknown")


def error_facts(error: RigError) -> dict[str, Any]:
    """Return an error as plain values for JSON; its message names options of the command instead of arguments."""
    return {**error.as_mapping(), "error": _with_options(error.message)}


class StatusLine:
    """A progress display on one line of standard error; without a terminal, a line for each step."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet or told_quiet()
        self._shown = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._shown and on_terminal():
            click.echo("\r\033[K", nl=False, err=True)

    def on_progress(self, what: str, share: float) -> None:
        """Show the name of a step, `what`, and the completed share of it (0 to 1)."""
        if self._quiet:
            return
        if on_terminal():
            click.echo(f"\r\033[K{what} … {100 * share:.0f} %", nl=False, err=True)
        elif what != self._shown:
            click.echo(f"{what} …", err=True)
        self._shown = what
