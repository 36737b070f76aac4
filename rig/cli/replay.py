"""``rig replay``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rig.cli import options, output
from rig.core.sample import unit_of
from rig.experiments.replay import replay as run
from rig.recording.reader import open_recording
from rig.views.plots.replay import draw_replay


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("-K", "--stiffness", type=float, help="Another wall stiffness.")
@click.option("-B", "--damping", type=float, help="Another wall damping.")
@click.option("--rate", metavar="T1/T2", help="Another velocity rate T2; T1 is the recording's.")
@click.option("--estimator", help="Another velocity estimator.")
@click.option("--set", "sets", multiple=True, metavar="KEY=VALUE", help="Any other key.")
@click.option(
    "--plot",
    type=click.Path(path_type=Path),
    help=f"Draw recorded and replayed into this file; {options.PICTURE_NAME}.",
)
@options.json_option
def replay(recording: Path, plot: Path | None, as_json: bool, **changed: Any) -> None:
    """Run the inputs of RECORDING through the same law (bit-exact) or another one.

    The handle moves as it was recorded: this shows what another estimator or law would have commanded, not
    what it would have done to the motion.
    """
    opened = open_recording(recording)
    result = run(opened, options.changes(**changed))
    if plot is not None:
        draw_replay(result, plot)
    if as_json:
        output.print_json(result)
        return
    velocity, effort = (unit_of(q, opened.header["motion"]) for q in ("velocity", "effort"))
    click.echo(f"{recording}: {len(result.rows)} ticks through {result.estimator} and {result.law}")
    output.print_pairs(
        [
            ("equal to the last bit", "yes" if result.exact else "no"),
            ("velocity differs by", f"{result.velocity_difference:.4g} {velocity} rms"),
            ("effort differs by", f"{result.effort_difference:.4g} {effort} rms"),
        ]
    )
