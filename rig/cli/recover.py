"""The command ``rig recording recover``: convert captures that a crash left to recordings.

`rig.experiments.trials.recover` recovers; this file finds the captures and prints.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from rig.cli import _values as values
from rig.cli import options, output
from rig.cli.command import command
from rig.experiments.trials import recover as recovering
from rig.experiments.trials.recover import Recovered


@command()
@click.argument("paths", nargs=-1, required=True, type=values.RECORDING, metavar="PATH…")
@options.json_option
def recover(paths: tuple[Path, ...], as_json: bool) -> None:
    """Recover recordings from captures (.rigcap) that a crash left unfinished, at PATH or anywhere below it.

    Prints for each capture what was lost. A capture that a running loop still writes is skipped; nothing is
    overwritten.
    """
    with _bar(quiet=as_json) as progress:
        results = recovering.recover(paths, progress=progress)
    error = recovering.failed(results)
    if as_json:
        facts = None if error is None else output.error_facts(error)
        output.print_json({"captures": results, "error": facts})
    elif not results:
        click.echo("nothing to recover: all recordings are sealed")
    else:
        for result in results:
            click.echo(_line(result))
    if error is not None:
        error.reported = as_json
        raise error


@contextmanager
def _bar(*, quiet: bool) -> Iterator[Callable[[int, int, Path], None] | None]:
    if quiet or not output.on_terminal():
        yield None
        return
    columns = (TextColumn("recovering"), BarColumn(), TextColumn("{task.fields[name]}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task("recovering", total=None, name="")
        yield lambda done, count, path: bars.update(task, completed=done, total=count, name=path.name)


def _line(result: Recovered) -> str:
    if result.recording is None:
        return f"{result.capture}: {result.outcome}: {result.reason}"
    parts = [f"{result.rows:,} rows, {result.duration_s:.3g} s"]
    if result.rows_lost:
        parts.append(f"{result.rows_lost:,} rows in the middle are damaged")
    if result.complete:
        parts.append("complete")
    elif result.lost_at_most_s is None:
        parts.append("the end of the simulation is missing")
    if result.lost_at_most_s:
        parts.append(f"at most {result.lost_at_most_s:.3g} s lost")
    return f"{result.recording}: {', '.join(parts)}"
