"""Command ``rig serve lsl``: stream running control loops by Lab Streaming Layer."""

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
@click.option(
    "--pid", type=click.IntRange(1), help="Process (PID) whose loops are streamed. [any process of yours]"
)
@click.option(
    "--rate", type=options.Hertz(1, 1_000_000), help="Largest number of samples per second. [every tick]"
)
@click.option("--name", default="haptic-rig", show_default=True, help="Prefix of the streams' names.")
@click.option(
    "--open-early",
    "expected",
    nargs=2,
    type=(click.Choice(["rotary", "linear"]), float),
    metavar="MOTION HZ",
    help="Open the stream of samples before the first loop starts, for this motion and position rate.",
)
@click.option("--blind", is_flag=True, help="Send no marker that reveals the wall.")
@click.option("--once", is_flag=True, help="Exit when the first loop ends.")
@click.option(
    "--markers", is_flag=True, help="Also send each line of standard input as a marker, until the input ends."
)
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
    session reports. Loops are only read: no receiver can slow them. A plot of effort over penetration reveals the
    stiffness; --blind concerns only the markers.

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
        f"{served.loops} loops, {served.samples} samples, {served.markers} markers sent; "
        f"{served.lost} rows were overwritten before they were read"
    )
