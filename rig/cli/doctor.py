"""``rig doctor``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from rig import config
from rig.bench.doctor.examine import Examination, Question, examine
from rig.bench.doctor.finding import Finding
from rig.bench.doctor.gate import Gate
from rig.bench.doctor.round_trip import LinkMeasurement
from rig.bench.doctor.udev import udev_rules
from rig.bench.doctor.walls import Supported
from rig.cli import hit_output, options, output
from rig.core.errors import PlanError
from rig.core.present import Table
from rig.core.sample import unit_of
from rig.recording.quantiles import Distribution, Quantile

_MARKS = {"ok": ("ok", "green"), "warning": ("!!", "yellow"), "problem": ("no", "red")}


@click.command()
@options.experiment_options
@click.option(
    "--url", help="Device to examine: serial:///dev/ttyACM0, usb://1209:0001. [machine and ports only]"
)
@click.option("--realtime", is_flag=True, help="Examine a simulated rig, as a process behind a port.")
@click.option(
    "--seconds",
    type=click.FloatRange(0.1, 600.0),
    default=4.0,
    show_default=True,
    help="How long to measure.",
)
@click.option("--print-udev", is_flag=True, help="Print udev rules for rigs, and do nothing else.")
@options.json_option
def doctor(
    file: Path | None,
    preset: str | None,
    url: str | None,
    realtime: bool,
    seconds: float,
    print_udev: bool,
    as_json: bool,
    **changed: Any,
) -> None:
    """Say what this machine and a link can do, and what mends what they cannot; changes nothing.

    The machine: rights, limits, kernel, timers, ports. With --url the device, too: who it is, the round trip, the
    rate that a loop can have, the walls that are stable with that delay, and whether the wall of the experiment may be
    armed. Commands that mend something are printed, never run.

    Exits with 2 when the wall must not be armed.
    """
    if print_udev:
        click.echo(udev_rules(), nl=False)
        return
    experiment = options.chosen_experiment(file, preset or options.preset_of(url, file))
    changes = options.changes(**changed)
    config.check_plugins(config.override(experiment, changes), str(file or preset or options.DEFAULT_PRESET))
    question = Question(experiment=experiment, changes=changes, url=url, realtime=realtime, seconds=seconds)
    with Progress(quiet=as_json) as progress:
        found = examine(question, progress.told)
    if as_json:
        error = None if found.error is None else output.error_facts(found.error)
        output.print_json({**found.as_mapping(), "error": error})
    else:
        _print(found)
    if found.error is not None:
        found.error.reported = as_json
        raise found.error
    if not found.armable and found.gate is not None:
        refused = PlanError("the wall of this experiment must not be armed here", remedy=found.gate.remedy)
        refused.reported = as_json
        raise refused


class Progress:
    """What is being done, on one line of standard error; lines of their own where it is no terminal."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._terminal = sys.stderr is not None and sys.stderr.isatty()
        self._said = ""

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *error: object) -> None:
        if self._said and self._terminal:
            click.echo("\r\033[K", nl=False, err=True)

    def told(self, what: str, share: float) -> None:
        """Show it."""
        if self._quiet:
            return
        if self._terminal:
            self._said = what
            click.echo(f"\r\033[K{what} … {100 * share:.0f} %", nl=False, err=True)
        elif what != self._said:
            self._said = what
            click.echo(f"{what} …", err=True)


def _print(found: Examination) -> None:
    if found.findings:
        click.echo("machine")
        for finding in found.findings:
            _print_finding(finding)
    if found.ports:
        click.echo("ports")
        output.print_pairs([(port.url, port.description) for port in found.ports])
    if found.device is not None:
        click.echo("device")
        output.print_pairs(_device_pairs(found))
    if found.measurement is not None:
        click.echo("link")
        output.print_pairs(_link_pairs(found.measurement))
    if found.walls:
        _print_walls(found)
    if found.gate is not None:
        _print_gate(found, found.gate)


def _print_finding(finding: Finding) -> None:
    mark, colour = _MARKS[finding.outcome]
    click.echo(f"  {click.style(mark, fg=colour)} {finding.name}: {finding.text}")
    if finding.outcome != "ok":
        click.echo(f"     {finding.why}")
    if finding.command:
        click.echo(f"     {finding.command}")


def _device_pairs(found: Examination) -> list[tuple[str, str]]:
    device = found.device
    assert device is not None
    kind = " (simulated)" if device.simulated else ""
    pairs = [
        ("url", device.url),
        ("device", f"{device.device}{kind}, firmware {device.firmware}"),
        ("protocol", f"{device.protocol}, ours {device.our_protocol}"),
        ("state", device.state if device.fault is None else f"{device.state}: {device.fault}"),
        ("rates", f"{device.position_rate_default} Hz, up to {device.position_rate_maximum} Hz"),
    ]
    return [*pairs, *(("!!", message) for message in device.messages)]


def _link_pairs(link: LinkMeasurement) -> list[tuple[str, str]]:
    asked = "as fast as it answers" if link.asked_rate_hz is None else f"at {link.asked_rate_hz:g} Hz"
    carries = "" if link.capacity is None else f", of {link.capacity / 1e3:.1f} kB/s"
    pairs = [
        ("questions", f"{link.sent} in {link.duration_s:.1f} s, {asked}"),
        ("round trip", _times(link.round_trip)),
        ("there and back", _times(link.travel) if link.stamps_trusted else "not known: bad stamps of the device"),
    ]  # fmt: skip
    if not link.virtual:
        pairs.append(
            (
                "loop rate",
                f"up to {link.loop_rate_hz:.0f} Hz with one tick of delay for 99.9 % of the commands",
            )
        )
        if link.travel.p999.high is None:
            bounded = 100 * link.travel.bounded
            pairs.append(
                ("", f"too few answers to bound p99.9: the longest bounds p{bounded:.5g}; measure longer")
            )
    return [
        *pairs,
        ("lost", f"{link.lost} ({100 * link.loss_share:.2g} %), {link.late} late, {link.unsent} not taken, "
                 f"{link.bad_frames} broken frames"),
        ("bytes", f"{link.bytes_to_device / 1e3:.1f} kB/s there, {link.bytes_to_host / 1e3:.1f} kB/s back{carries}"),
    ]  # fmt: skip


def _times(times: Distribution) -> str:
    parts = [
        f"{name} {_time(q)}" for name, q in (("p50", times.p50), ("p99", times.p99), ("p99.9", times.p999))
    ]
    return f"{', '.join(parts)}, longest {1e3 * times.maximum:.3g} ms"


def _time(quantile: Quantile) -> str:
    low, high = ("?" if bound is None else f"{1e3 * bound:.3g}" for bound in (quantile.low, quantile.high))
    return f"{1e3 * quantile.value:.3g} ms ({low} … {high})"


def _print_walls(found: Examination) -> None:
    assert found.experiment is not None
    motion = found.experiment.rig.motion
    click.echo(
        f"walls: largest stable K ({unit_of('stiffness', motion)}) in the hand where it is least, "
        f"at B ({unit_of('damping', motion)})"
    )
    dampings = next(([b for b, _ in row.k_max] for row in found.walls if row.k_max), [])
    head = ["scheme", "delay", *(f"B = {b:g}" for b in dampings), "because"]
    output.print_table(Table(head, [_wall_row(row, len(dampings)) for row in found.walls]))
    for reason in dict.fromkeys(row.reason for row in found.walls if row.reason):
        click.echo(f"  {reason}")


def _wall_row(row: Supported, columns: int) -> list[str]:
    cells = ["–"] * columns
    if row.k_max:
        least = [row.least(i) for i in range(len(row.k_max))]
        cells = [f"{value:.4g} ({'no hand' if hand == 'none' else hand})" for hand, value in least]
    ticks = f"{row.delay_ticks} tick{'' if row.delay_ticks == 1 else 's'}"
    return [row.label, ticks, *cells, row.because]


def _print_gate(found: Examination, gate: Gate) -> None:
    assert found.experiment is not None
    click.echo("arming")
    if gate.armable:
        mark, says = click.style("ok", fg="green"), "may be armed"
    elif gate.simulated:
        mark, says = click.style("!!", fg="yellow"), "would be refused on a real rig; this one is simulated"
    else:
        mark, says = click.style("no", fg="red"), "must not be armed"
    click.echo(f"  {mark} {hit_output.headline(found.experiment)}: {says}")
    for reason in gate.reasons:
        click.echo(f"     {reason.text}: {reason.remedy}")
    radius = ", ".join(
        f"{'no hand' if hand == 'none' else hand} {value:.4g}" for hand, value in gate.spectral_radius.items()
    )
    if radius:
        click.echo(f"     spectral radius with {gate.delay_ticks} ticks of delay: {radius}")
    for note in gate.notes:
        click.echo(f"     {note}")
