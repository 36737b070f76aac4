"""The command ``rig recording replay``."""

from pathlib import Path
from typing import Any

import click

from rig.cli import _values as values
from rig.cli import options, output
from rig.cli.command import command
from rig.core.present import plain
from rig.core.sample import unit_of
from rig.experiments.trials.replay import replay as run
from rig.recording.reader import open_recording


@command()
@click.argument("recording", type=values.RECORDING)
@options.wall_options
@options.rate_option("Another velocity rate T2; T1 remains that of the recording.", "T1/T2")
@options.estimator_option()
@options.set_option
@options.picture_options("Draw recorded and replayed.", default=False, place="RECORDING-replay.png")
@options.json_option
def replay(recording: Path, picture: options.PictureOption, as_json: bool, **changed: Any) -> None:
    """Compute the control law again from the inputs of RECORDING, with the same law (bit-exact) or another one.

    The recorded motion is the input: the result shows what another estimator or law would have commanded, not how the
    motion would have changed.
    """
    opened = open_recording(recording)
    result = run(opened, options.changes(**changed))
    picture.draw(recording.with_name(f"{recording.stem}-replay"), lambda path: result.plot().save(path))
    if as_json:
        output.print_json({**plain(result), **picture.facts()})
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
