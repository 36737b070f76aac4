"""``rig timing``."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli import options, output
from rig.core.errors import RigError
from rig.core.present import Table, duration
from rig.experiments.timing import timing_of
from rig.recording.quantiles import Quantile
from rig.recording.timing import LATENESS, STAGES, TimingSummary
from rig.views.plots.timing import draw_timing

_COUNTS = {
    "late": "late by more than a period",
    "lost": "samples lost",
    "skipped": "samples skipped for a newer one",
    "stale": "ticks without a fresh sample",
    "duplicated": "samples twice",
    "reordered": "samples out of order",
    "overruns": "grid points overrun",
    "unsent": "commands that the link did not take",
    "rows_dropped": "rows not recorded",
}


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--plot/--no-plot", default=True, help="Draw a picture.")
@click.option(
    "-o", "--output", "picture", type=click.Path(path_type=Path),
    help="PNG to write. [beside the recording]",
)  # fmt: skip
@options.json_option
def timing(recording: Path, plot: bool, picture: Path | None, as_json: bool) -> None:
    """Show where the time of each tick in RECORDING went: sampled, received, computed, sent, applied.

    Sampled and applied are times of the device, put on the host's clock by the exchanges of the run; without them only
    the host's share is known.
    """
    found = timing_of(recording)
    drawn, failure = None, None
    if plot:
        target = picture or recording.with_name(f"{recording.stem}-timing.png")
        try:
            drawn = draw_timing(found.ledger, found.summary, target, title=recording.name)
        except RigError as error:  # the numbers are there all the same
            failure = error
    if as_json:
        mapping = found.summary.as_mapping()
        facts = {} if failure is None else {"error": output.error_facts(failure)}
        output.print_json({**mapping, "picture": None if drawn is None else str(drawn), **facts})
    else:
        _print(recording, found.summary)
        if drawn is not None:
            click.echo(f"picture\n  {drawn}")
    if failure is not None:
        failure.reported = as_json
        raise failure


def _print(recording: Path, summary: TimingSummary) -> None:
    rate = f"one every {duration(summary.period_ns)}"
    click.echo(f"{recording}: {summary.ticks} ticks in {summary.duration_s:.4g} s, {rate}")
    head = ("stage", "ticks", "least", "p50", "p99", "p99.9", "longest")
    output.print_table(Table(head, _stages(summary)))
    if summary.loop == "device":
        click.echo("law on the device")
        output.print_pairs(_on_device(summary))
    click.echo("counted apart")
    output.print_pairs(_counts(summary))
    click.echo("clock")
    output.print_pairs(_clock(summary))
    if summary.worst:
        click.echo("worst ticks")
        output.print_table(_worst(summary))


def _stages(summary: TimingSummary) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for name, stage in summary.stages.items():
        if stage is None:
            if summary.loop == "host":
                rows.append((_label(name), "0", "", "unknown", "", "", ""))
            continue
        quantiles = (_shown(quantile) for quantile in stage.quantiles.values())
        ends = duration(stage.minimum), duration(stage.maximum)
        rows.append((_label(name), str(stage.ticks), ends[0], *quantiles, ends[1]))
    return rows


def _label(name: str) -> str:
    return STAGES[name][2] if name in STAGES else "late on the grid of the samples"


def _shown(quantile: Quantile) -> str:
    """A quantile, with the upper bound at 95 % where the ticks suffice for one: ``87 µs (≤ 93 µs)``."""
    text = duration(quantile.value)
    if quantile.high is None or quantile.high == quantile.value:
        return text
    return f"{text} (≤ {duration(quantile.high)})"


def _counts(summary: TimingSummary) -> list[tuple[str, str]]:
    pairs = [
        (text, "not recorded" if summary.counts[name] is None else str(summary.counts[name]))
        for name, text in _COUNTS.items()
    ]
    return [
        *pairs,
        ("samples that the law did not see", str(summary.passed_over)),
    ] + (
        []
        if summary.loop == "device"
        else [
            ("commands never seen active", str(summary.never_active)),
            ("commands sent at the end, unanswered", str(summary.unanswered)),
        ]
    )


def _on_device(summary: TimingSummary) -> list[tuple[str, str]]:
    """What stands for the ways of a command that there was not."""
    worst = "not told" if not summary.execution_ns else duration(summary.execution_ns)
    return [
        ("from a sample to its effort", "within the device's own tick: no command answers a sample"),
        ("worst execution time of a tick", worst),
    ]


def _clock(summary: TimingSummary) -> list[tuple[str, str]]:
    if summary.clock is None or summary.clock_sd_ns is None:
        return [
            (
                "none",
                "no stamps are recorded (a run cut off keeps none): when samples were taken and commands applied is "
                "unknown",
            )
        ]
    doubt = duration(summary.clock_sd_ns)
    pairs = [
        *((row.label, row.text) for row in summary.clock.rows()),
        ("sampled, applied", f"± {doubt} at worst"),
    ]
    if summary.within_tick:
        text = f"{summary.within_tick} commands came within the tick in which they were sent: taken as applied at once"
        pairs.append(("", text))
    out = summary.stages["transport_out"]
    if out is not None and out.negative:
        text = (
            f"{out.negative} commands seem applied before they were sent: the device ran behind its own clock"
        )
        pairs.append(("", text))
    return pairs


def _worst(summary: TimingSummary) -> Table:
    names = ("transport_in", "law", "send", "transport_out", "whole", LATENESS)
    rows = []
    for bad in summary.worst:
        lengths = (bad.stages[name] for name in names)
        shown = ("?" if length is None else duration(length) for length in lengths)
        rows.append((str(bad.tick), f"{bad.time_s:.4f} s", *shown))
    return Table(("tick", "at", "in", "law", "send", "out", "whole", "late"), rows)
