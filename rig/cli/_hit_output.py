"""Print wall hits: a line for the experiment, some lines for the verdict, and a progress bar while the handle moves.

The commands `hit`, `plan`, `show` and `zwidth` use it. It must not judge a hit.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from rig.cli import output
from rig.config import Experiment, describe, push_s
from rig.core.sample import phase_name, unit_of

# key → beginning of the keys that are listed with it
_CHANGED_TOGETHER = {"operator.grip": "operator.", "controller.estimator": "controller.parameters"}


def push_text(experiment: Experiment) -> str:
    """Return a phrase about what pushes the handle: a simulated hand, or the motor with its effort."""
    trial = experiment.trial
    if trial.kind == "human":
        return f"in a simulated hand ({experiment.operator.grip})"
    return f"pushed by {trial.effort:g} {unit_of('effort', experiment.rig.motion)}"


def headline(experiment: Experiment) -> str:
    """Return one line with the rig's name, stiffness and damping of the wall, sampling rates and estimator."""
    return experiment.headline()


class ProgressBars:
    """Progress bars of wall hits, shown only on a terminal; pass `watch` to `rig.experiments.hits.hit.hit`."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet or not output.on_terminal()
        self._bars: Any = None

    def __enter__(self) -> ProgressBars:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Remove the progress bar, so that other output can be printed."""
        if self._bars is not None:
            self._bars.stop()
            self._bars = None

    def watch(self, repeat: int, experiment: Experiment) -> Callable[[int, int], None] | None:
        """Show a bar for wall hit `repeat` (from 0); return the function that updates it; None without a terminal."""
        if self._quiet:
            return None
        phase = TextColumn("{task.fields[phase]:<8}")
        columns = (TextColumn("{task.description}"), BarColumn(), phase, TimeRemainingColumn())
        bars = self._bars = Progress(*columns, console=Console(stderr=True), transient=True)
        trial, rate = experiment.trial, experiment.controller.position_rate
        least_s = experiment.homing.settle_s + push_s(experiment) + trial.release_s
        task = bars.add_task(f"hit {repeat + 1}/{trial.repeats}", total=round(least_s * rate), phase="")
        bars.start()

        def update(ticks: int, phase_now: int) -> None:
            bars.update(task, completed=ticks, phase=phase_name(phase_now))

        return update


def measuring_link(quiet: bool) -> Callable[[float], None] | None:
    """Return a function that shows the progress (0 to 1) of measuring the link's delay; None without a terminal."""
    if quiet or not output.on_terminal():
        return None

    def update(share: float) -> None:
        text = f"measuring the link … {100 * share:.0f} %" if share < 1.0 else ""
        click.echo(f"\r\033[K{text}", nl=False, err=True)

    return update


def differences(asked: Experiment, effective: Experiment, meant: Collection[str]) -> list[str]:
    """Return a text like ``wall.stiffness = 60.0 instead of 300.0`` for each setting whose value differs.

    `asked` is the requested experiment, `effective` the one that ran. Settings in `meant` were changed on purpose and
    are left out. A changed grip also leaves out the other settings of the operator, a changed estimator its parameters.
    """
    brought = tuple(prefix for key, prefix in _CHANGED_TOGETHER.items() if key in meant)
    before = {line.key: line.value for line in describe(asked)}
    return [
        f"{line.key} = {line.value} instead of {before[line.key]}"
        for line in describe(effective)
        if line.key not in meant
        and not line.key.startswith(("realtime", *brought))
        and line.key in before
        and before[line.key] != line.value
    ]
