"""How commands print: aligned lines for people, JSON for machines, signs of life on standard error."""

from __future__ import annotations

import json
import math
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from rig.core.sample import Phase, unit_of

if TYPE_CHECKING:
    from rig.config import Experiment
    from rig.control.verdict import Verdict
    from rig.core.errors import RigError

_BRINGS = {
    "operator.grip": "operator.",
    "controller.estimator": "controller.parameters",
}  # key → keys that follow it
_COLOURS = {"stable": "green", "limit cycle": "yellow", "unstable": "red", "invalid": "magenta"}


def print_json(value: Any) -> None:
    """One JSON document on standard output; what is not finite becomes null."""
    click.echo(json.dumps(_finite(value), ensure_ascii=False, indent=2))


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


def print_pairs(pairs: list[tuple[str, str]]) -> None:
    """Name and value, one pair a line, aligned."""
    width = max((len(name) for name, _ in pairs), default=0)
    for name, value in pairs:
        click.echo(f"  {name:<{width}}  {value}")


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Rows of texts in aligned columns, the first of them left, the others right; the first row is the head."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        first, *others = (
            cell.ljust(w) if i == 0 else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        click.echo("  " + "  ".join([first, *others]).rstrip())


def duration(value_ns: float) -> str:
    """Time of three digits in the unit that suits it: ``412 ns``, ``87.5 µs``, ``-1.2 ms``."""
    for limit, factor, unit in ((1e3, 1.0, "ns"), (1e6, 1e-3, "µs"), (1e9, 1e-6, "ms")):
        if abs(value_ns) < 0.9995 * limit:
            return f"{value_ns * factor:.3g} {unit}"
    return f"{value_ns * 1e-9:.4g} s"


def clock_pairs(clock: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Lines of a clock fit (`rig.core.clock_fit.ClockFit.as_mapping`)."""
    asymmetry = duration(clock["asymmetry_bound_ns"])
    return [
        (
            "clock offset",
            f"{clock['offset_ns'] * 1e-9:.9f} s ± {duration(clock['offset_sd_ns'])}, "
            f"and at most {asymmetry} if the ways differ",
        ),
        ("clock drift", f"{clock['drift_ppm']:.2f} ± {clock['drift_sd_ppm']:.2g} ppm"),
        ("round trip", f"{duration(clock['round_trip_ns'])} at least"),
        (
            "exchanges",
            f"{clock['used']} over {duration(clock['span_ns'])}, {clock['rejected']} rejected",
        ),
    ]


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


def coloured(kind: str) -> str:
    """Return a verdict in its colour."""
    return click.style(kind, fg=_COLOURS.get(kind), bold=True)


def verdict_pairs(experiment: Experiment, verdict: Verdict, true: Verdict | None) -> list[tuple[str, str]]:
    """Return the lines of a verdict, the true numbers beside the recorded ones where there are any."""
    from rig.config import verdict_limits  # noqa: PLC0415

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
    pairs = [("verdict", beside(coloured(verdict.kind), lambda v: coloured(v.kind)))]
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


@contextmanager
def compiling() -> Iterator[None]:
    """Say once that the kernels are being compiled, and show that the program is alive meanwhile."""
    from rig.realtime.kernel import is_cold, mark_warm  # noqa: PLC0415

    if not is_cold():
        yield
        return
    done = threading.Event()
    thread = threading.Thread(target=_signs_of_life, args=(done,), daemon=True)
    thread.start()
    try:
        yield
        mark_warm()
    finally:
        done.set()
        thread.join()


def _signs_of_life(done: threading.Event) -> None:
    started = time.monotonic()
    text = "compiling the loop, once for this version and machine (half a minute)"
    if not _on_terminal():
        click.echo(f"{text} …", err=True)
        while not done.wait(5.0):
            click.echo(f"  still compiling, {time.monotonic() - started:.0f} s", err=True)
        return
    while not done.wait(0.2):
        click.echo(f"\r{text}: {time.monotonic() - started:.0f} s ", nl=False, err=True)
    click.echo(f"\r{text}: done in {time.monotonic() - started:.0f} s", err=True)


class ProgressBars:
    """One bar for each hit, on a terminal only. `watch` is a `rig.experiments.hit.Watch`; `stop` clears the bar."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet or not _on_terminal()
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
        from rich.console import Console  # noqa: PLC0415
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: PLC0415

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
    if quiet or not _on_terminal():
        return None

    def told(share: float) -> None:
        text = f"measuring the link … {100 * share:.0f} %" if share < 1.0 else ""
        click.echo(f"\r\033[K{text}", nl=False, err=True)

    return told


def _on_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


def differences(asked: Experiment, effective: Experiment, meant: Collection[str]) -> list[str]:
    """Keys whose value in effect is not the asked one, ``wall.stiffness = 60.0 instead of 300.0``, but for `meant`.

    A grip that is meant brings the operator's numbers, an estimator its settings.
    """
    from rig.config import describe  # noqa: PLC0415

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


def error_facts(error: RigError) -> dict[str, Any]:
    """Return an error for a machine."""
    return {
        "error": error.message,
        "kind": type(error).__name__,
        "remedy": error.remedy,
        "recording": None if error.recording is None else str(error.recording),
        "messages": list(error.messages),
        "exit_code": error.exit_code,
    }
