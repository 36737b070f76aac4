"""How commands print hits: the experiment in a line, the verdict in a few, a bar while it runs."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from rig.cli import output
from rig.config import Experiment, describe, verdict_limits
from rig.control.verdict import Verdict
from rig.core.sample import Phase, unit_of

_BRINGS = {
    "operator.grip": "operator.",
    "controller.estimator": "controller.parameters",
}  # key → keys that follow it


def push_text(experiment: Experiment) -> str:
    """Who pushes, in a few words."""
    trial = experiment.trial
    if trial.kind == "human":
        return f"in a simulated hand ({experiment.operator.grip})"
    return f"pushed by {trial.effort:g} {unit_of('effort', experiment.rig.motion)}"


def headline(experiment: Experiment) -> str:
    """Rig, wall and scheme in one line."""
    motion, wall, rates = experiment.rig.motion, experiment.wall, experiment.controller
    scheme = "uniform" if rates.position_rate == rates.velocity_rate else "dual-rate"
    return (
        f"{experiment.rig.name}: K = {wall.stiffness:g} {unit_of('stiffness', motion)}, "
        f"B = {wall.damping:g} {unit_of('damping', motion)}, "
        f"{scheme} {rates.position_rate / 1e3:g}/{rates.velocity_rate / 1e3:g} kHz, {rates.estimator}"
        + (", law on the device" if rates.loop == "device" else "")
    )


def verdict_pairs(experiment: Experiment, verdict: Verdict, true: Verdict | None) -> list[tuple[str, str]]:
    """Return the lines of a verdict, the true numbers beside the recorded ones where there are any."""
    limits, count = verdict_limits(experiment), experiment.rig.encoder.resolution
    position, velocity, effort = (
        unit_of(q, experiment.rig.motion) for q in ("position", "velocity", "effort")
    )

    def beside(text: str, show: Callable[[Verdict], str]) -> str:
        return text if true is None else f"{text}   (true: {show(true)})"

    def depth(value: float) -> str:
        return f"{value:.4g} {position} ({value / count:.1f} counts)"

    def against(value: float, limit: float, unit: str) -> str:
        return f"{_shown(value, limit)} {unit}, limit {limit:.3g}"

    def felt(v: Verdict) -> str:
        return "not measurable" if v.felt is None else _shown(v.felt, limits.felt_velocity)

    floor = f"the encoder's floor is {verdict.felt_floor:.2g} {velocity}, limit {limits.felt_velocity:.3g}"
    felt_line = (
        f"not measurable: {floor}" if verdict.felt is None else f"{felt(verdict)} {velocity} rms; {floor}"
    )
    if verdict.felt_floor == 0.0 and not verdict.felt:
        felt_line = "no count changed in the tail; motion below one count is not seen"
    pairs = [("verdict", beside(output.coloured(verdict.kind), lambda v: output.coloured(v.kind)))]
    pairs += [("", reason) for reason in verdict.reasons]
    if true is not None and true.kind != verdict.kind:
        pairs += [("", f"true: {reason}") for reason in true.reasons]
    if verdict.contact_s is not None and verdict.impact_velocity is not None:
        pairs.append(
            ("first contact", f"{verdict.contact_s:.4g} s at {verdict.impact_velocity:.3g} {velocity}")
        )
    settling = "never" if verdict.settling_s is None else f"{verdict.settling_s:.3g} s"
    return [
        *pairs,
        ("peak penetration", beside(depth(verdict.peak_penetration), lambda v: f"{v.peak_penetration:.4g}")),
        (
            "resting penetration",
            beside(depth(verdict.resting_penetration), lambda v: f"{v.resting_penetration:.4g}"),
        ),
        ("settling time", settling),
        ("peak effort", f"{verdict.peak_effort:.3g} {effort}, limit {experiment.rig.limits.effort:g}"),
        (
            "felt",
            beside(felt_line, felt),
        ),
        (
            "heard",
            beside(
                against(verdict.heard, limits.heard_effort, f"{effort} rms"),
                lambda v: _shown(v.heard, limits.heard_effort),
            ),
        ),
        (
            "moved",
            beside(
                against(verdict.moved, limits.moved, f"{position} p-p"),
                lambda v: _shown(v.moved, limits.moved),
            ),
        ),
        ("saturated", f"{100 * verdict.saturated_fraction:.2g} % of ticks"),
        ("late, gaps", f"{verdict.late_ticks} late ticks, {verdict.gaps} gaps in {verdict.ticks}"),
    ]


def _shown(value: float, limit: float) -> str:
    """Three digits; what is nothing against its limit is 0, not the rounding of a filter."""
    return "0" if abs(value) < 1e-6 * limit else f"{value:.3g}"


class ProgressBars:
    """One bar for each hit, on a terminal only. `watch` is a `rig.experiments.hit.Watch`; `stop` clears the bar."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet or not output.on_terminal()
        self._bars: Any = None

    def __enter__(self) -> ProgressBars:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Take the bar away, so that what is printed next stands alone."""
        if self._bars is not None:
            self._bars.stop()
            self._bars = None

    def watch(self, repeat: int, experiment: Experiment) -> Callable[[int, int], None] | None:
        """Show a bar for this repeat."""
        if self._quiet:
            return None
        phase = TextColumn("{task.fields[phase]:<8}")
        columns = (TextColumn("{task.description}"), BarColumn(), phase, TimeRemainingColumn())
        bars = self._bars = Progress(*columns, console=Console(stderr=True), transient=True)
        trial, rate = experiment.trial, experiment.controller.position_rate
        least_s = experiment.homing.settle_s + trial.duration_s + trial.release_s
        task = bars.add_task(f"hit {repeat + 1}/{trial.repeats}", total=round(least_s * rate), phase="")
        bars.start()

        def told(ticks: int, phase_now: int) -> None:
            bars.update(task, completed=ticks, phase=Phase(phase_now).name.lower())

        return told


def measuring_link(quiet: bool) -> Callable[[float], None] | None:
    """What shows how far the measurement of a link is, on a terminal only; it takes its line away at the end."""
    if quiet or not output.on_terminal():
        return None

    def told(share: float) -> None:
        text = f"measuring the link … {100 * share:.0f} %" if share < 1.0 else ""
        click.echo(f"\r\033[K{text}", nl=False, err=True)

    return told


def differences(asked: Experiment, effective: Experiment, meant: Collection[str]) -> list[str]:
    """Keys whose value in effect is not the asked one, ``wall.stiffness = 60.0 instead of 300.0``, but for `meant`.

    A grip that is meant brings the operator's numbers, an estimator its settings.
    """
    brought = tuple(prefix for key, prefix in _BRINGS.items() if key in meant)
    before = {line.key: line.value for line in describe(asked)}
    return [
        f"{line.key} = {line.value} instead of {before[line.key]}"
        for line in describe(effective)
        if line.key not in meant
        and not line.key.startswith(("realtime", *brought))
        and line.key in before
        and before[line.key] != line.value
    ]
