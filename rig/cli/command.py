"""Common appearance of all commands: options in groups, and the option ``-q``.

All commands of the core and of the extras are created with it. It must not depend on a single command.
"""

import os
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from typing import Any

import click

# Groups of the help page; groups of one command stand before DEVICE.
EXPERIMENT, OWN, DEVICE, RESULT = "Experiment", "Options", "Device", "Result"
_QUIET = "rig.cli.quiet"  # where a context keeps it


class Option(click.Option):
    """An option that belongs to a group of the help page."""

    def __init__(self, *declared: Any, group: str = OWN, **more: Any) -> None:
        super().__init__(*declared, **more)
        self.group = group


option = partial(click.option, cls=Option)
json_option = option("--json", "as_json", group=RESULT, is_flag=True, help="Print JSON for machines.")


def quiet() -> bool:
    """Return True if the running command was called with ``-q``."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(_QUIET))


def _store_quiet(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    context.meta[_QUIET] = value


class GroupedCommand(click.Command):
    """A command whose options are listed in groups on its help page; `quiet` is True if it accepts ``-q``."""

    def __init__(self, *arguments: Any, quiet: bool = True, **more: Any) -> None:
        super().__init__(*arguments, **more)
        if quiet:
            self.params.append(
                Option(
                    ["-q", "--quiet"],
                    group=RESULT,
                    is_flag=True,
                    expose_value=False,
                    callback=_store_quiet,
                    help="Print warnings and errors only (and JSON, with --json); the exit code gives "
                    "the result.",
                )
            )

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write a section of the help page for each group of options: experiment, the command's own, device, result."""
        groups: dict[str, list[tuple[str, str]]] = {EXPERIMENT: [], OWN: []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            group = getattr(parameter, "group", RESULT if "--help" in parameter.opts else OWN)
            if record is not None:
                groups.setdefault(group, []).append(record)
        for last in (DEVICE, RESULT):
            groups[last] = groups.pop(last, [])
        for title, records in groups.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; with ``-q`` suppress standard output, except JSON."""
        if not ctx.meta.get(_QUIET) or ctx.params.get("as_json"):
            return super().invoke(ctx)
        with open(os.devnull, "w", encoding="utf-8") as nothing, redirect_stdout(nothing):
            return super().invoke(ctx)


def command(name: str | None = None, *, quiet: bool = True) -> Callable[[Callable[..., Any]], GroupedCommand]:
    """Return a decorator that creates a command `name` from a function; `quiet` is True if it accepts ``-q``."""
    return click.command(name, cls=GroupedCommand, quiet=quiet)
