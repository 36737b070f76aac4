"""``rig serve lsl``."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

import click

from rig.cli import options, output
from rig.cli.command import command
from rig.core.present import plain
from rig.core.sample import Motion
from rig.extras.lsl.serve import serve


@command()
@click.option("--pid", type=click.IntRange(1), help="Process whose loops to follow. [any of yours]")
@click.option("--rate", type=options.Hertz(1, 1_000_000), help="Samples a second at most. [every tick]")
@click.option("--name", default="haptic-rig", show_default=True, help="First word of the streams' names.")
@click.option(
    "--open-early",
    "expected",
    nargs=2,
    type=(click.Choice(["rotary", "linear"]), float),
    metavar="MOTION HZ",
    help="Open the samples' stream before the first loop: its motion and position rate.",
)
@click.option("--blind", is_flag=True, help="No marker says anything of the wall.")
@click.option("--once", is_flag=True, help="End with the first loop.")
@click.option("--markers", is_flag=True, help="Also send markers from standard input, until that ends.")
@options.json_option
def lsl(
    pid: int | None,
    rate: int | None,
    name: str,
    expected: tuple[Motion, float] | None,
    blind: bool,
    once: bool,
    markers: bool,
    as_json: bool,
) -> None:
    """Stream the loops that run in real time by Lab Streaming Layer, until Ctrl-C.

    Two streams: "NAME samples" has position, velocity, penetration, effort sent, effort applied and phase, each sample
    at its own time on LSL's clock; "NAME markers" has JSON texts: phases, contacts, edges of the sync input, and what a
    session says. A loop is only looked at: no receiver can slow it. Whoever plots effort over penetration sees the
    stiffness; --blind concerns the markers.

    --markers reads lines like {"at": NS, "marker": {"mark": "stimulus"}}; at is on CLOCK_MONOTONIC, or left out.
    --json prints a line for each stream and loop, the last with what was sent.
    """

    def report(news: Mapping[str, Any]) -> None:
        if as_json:
            click.echo(json.dumps(dict(news)))
        else:
            output.note("  ".join(f"{key} {value}" for key, value in news.items()))

    served = serve(
        pid,
        rate=rate,
        name=name,
        blind=blind,
        once=once,
        markers=sys.stdin.fileno() if markers else None,
        expected=expected,
        report=report,
    )
    if as_json:
        click.echo(json.dumps({"served": plain(served)}))
        return
    click.echo(
        f"{served.loops} loops, {served.samples} samples, {served.markers} markers sent; {served.lost} rows came "
        "too late to be seen"
    )
