"""Show the progress of a rehearsal (a session with a simulated person) on standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import click

from rig.session.conducting import DeskView, Event, line_of_event

# So many trials are timed before the remaining time is shown.
_SURE = 2


class Rehearsed:
    """Progress display of a rehearsal (a session with a simulated person), used as a context manager.

    The session calls `on_event` with each entry of its log, and `looks` with each state of the operator's console.
    `quiet` shows nothing; `clock` returns the time (s).
    """

    def __init__(self, *, quiet: bool, clock: Callable[[], float] = time.monotonic) -> None:
        self._quiet = quiet
        self._line = sys.stderr is not None and sys.stderr.isatty()
        self._clock = clock
        # First trial of this process: it may have compiled the loop, so its time is not representative.
        self._seen = 0
        # The next trial, and the time at which it was ready: the remaining time is extrapolated from it.
        self._first: tuple[int, float] | None = None
        self._shown = False

    def __enter__(self) -> Rehearsed:
        return self

    def __exit__(self, *error: object) -> None:
        if self._line and not self._quiet:
            click.echo("\r\033[K", nl=False, err=True)

    def on_event(self, event: Event) -> None:
        """Print an event of the session as a line, unless ``-q`` is given or a terminal shows the progress line."""
        if not self._line and not self._quiet:
            click.echo(f"  {line_of_event(event)}", err=True)

    def looks(self, view: DeskView) -> None:
        """Show the trial's number and the remaining time on the progress line; `view` is the state of the console."""
        if self._quiet or view.state != "ready":
            return
        left = self._left_s(view)
        words = f"trial {view.trial} of about {view.trials}, "
        words += "practice" if view.practice else f"block {view.block} of {view.blocks}"
        if left is not None:
            words += f", about {_rough(left)} left"
        if self._line:
            click.echo(f"\r\033[K{words}", nl=False, err=True)
        elif left is not None and not self._shown:
            self._shown = True
            click.echo(f"  {words}", err=True)

    def _left_s(self, view: DeskView) -> float | None:
        now = self._clock()
        if self._seen == 0:
            self._seen = view.trial
        elif self._first is None and view.trial > self._seen:
            self._first = view.trial, now
        if self._first is None or view.trial < self._first[0] + _SURE:
            return None
        trial, began = self._first
        return (now - began) / (view.trial - trial) * max(0, view.trials - view.trial + 1)


def _rough(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"
