"""Show the progress of a sweep (a computation of many tasks): a bar on a terminal, otherwise a line every ten seconds.

Commands that run a sweep use it. It writes to standard error, because standard output is for results.
"""

import time
from typing import Any, Self

import click
from rich import progress as rich_progress
from rich.console import Console

from rig.cli.command import quiet
from rig.cli.output import on_terminal
from rig.experiments.sweep import Progress

LINE_S = 10.0
_MINUTE_S, _HOUR_S = 60, 3600


class _Bar:
    """Base of `SweepBar` and `CountBar`: a bar in a ``with`` block, or lines if there is no terminal."""

    def __init__(self, what: str, *, plain: bool = False) -> None:
        self._what = what
        self._plain = plain or not on_terminal()
        self._quiet = quiet()
        self._bar: Any = None
        self._task: Any = None
        self._printed_s = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def _show(self, fraction: float, text: str) -> None:
        if self._quiet:
            return
        if self._plain:
            now = time.monotonic()
            if now - self._printed_s >= LINE_S:
                self._printed_s = now
                click.echo(f"{self._what}: {text}", err=True)
            return
        if self._bar is None:
            if fraction >= 1.0:
                return
            what, shown = (
                rich_progress.TextColumn(f"{{task.{name}}}") for name in ("description", "fields[text]")
            )
            columns = (what, rich_progress.BarColumn(), shown)
            self._bar = rich_progress.Progress(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task(self._what, total=1.0, text="")
            self._bar.start()
        self._bar.update(self._task, completed=fraction, text=text)


class SweepBar(_Bar):
    """A progress bar of one sweep (a computation of many tasks), for a ``with`` block.

    Pass `watch` to `rig.experiments.sweep.run`. `what` is a short name of the computation, `unit` that of the displayed
    rate, like ``trials``; with `plain` the bar prints lines even on a terminal, for commands that print JSON.
    """

    def __init__(self, what: str, *, unit: str = "tasks", plain: bool = False) -> None:
        super().__init__(what, plain=plain)
        self._unit = unit
        self._reported_damage = False

    def watch(self, progress: Progress) -> None:
        """Show the number of finished tasks of a sweep, and the remaining time."""
        if progress.damaged and not self._reported_damage:
            self._reported_damage = True
            click.echo(
                f"rig: the journal has {progress.damaged} damaged lines; their tasks run again", err=True
            )
        self._show(progress.fraction, self.text(progress))

    def text(self, progress: Progress) -> str:
        """Return a text like ``120 of 510 tasks, 1,240 trials/s, 1 min 20 s left``."""
        parts = [f"{progress.done} of {progress.total} tasks"]
        if progress.units:
            parts.append(f"{_rate(progress.units_per_s)} {self._unit}/s")
        if progress.stopping and progress.running:
            parts.append(f"stopping: waiting for {progress.running} more")
        elif not progress.workers and progress.done < progress.total:
            parts.append("waiting for workers")
        elif progress.seconds_left:
            parts.append(f"{_time(progress.seconds_left)} left")
        return ", ".join(parts)


def _rate(per_s: float) -> str:
    return f"{per_s:.2g}" if per_s < 10.0 else f"{per_s:,.0f}"


def _time(seconds: float) -> str:
    whole = round(seconds)
    if whole < _MINUTE_S:
        return f"{whole} s"
    if whole < _HOUR_S:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


class CountBar(_Bar):
    """A bar with the number of finished items, for a ``with`` block; call `watch` with (done, total)."""

    def watch(self, done: int, total: int) -> None:
        """Show the number of finished items and the total number."""
        self._show(done / total if total else 1.0, f"{done} of {total}")
