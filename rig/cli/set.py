"""The command ``rig set``."""

import click

from rig.cli import options, output
from rig.cli.command import command
from rig.core.errors import RunEndedError
from rig.experiments.trials import live


@command("set")
@click.argument("changes", nargs=-1, required=True, metavar="KEY=VALUE…")
@click.option("--pid", type=click.IntRange(1), help="Process of the loop, when several run.")
@click.option(
    "--wait",
    "patience_s",
    type=click.FloatRange(0.0, 3600.0),
    default=10.0,
    show_default=True,
    help="How long to wait until the loop uses the new values (s).",
)
@options.json_option
def set_(changes: tuple[str, ...], pid: int | None, patience_s: float, as_json: bool) -> None:
    """Change the wall of the loop that runs in real time: stiffness, damping, position, pull, damping_on.

    The change must first pass the checks of rig experiment plan. The loop uses all new values from the same tick on, as
    soon as the handle is outside the wall. A law on the device can change stiffness, damping and position only.
    Example: rig set stiffness=400 damping=0.5
    """
    values = options.key_values(changes)

    def posted(number: int) -> None:
        if not as_json:
            output.note(
                f"parameter set {number} is sent; it becomes active when the handle is outside the wall"
            )

    done = live.change_wall(values, pid, patience_s=patience_s, posted=posted)
    if as_json:
        output.print_json(done)
    if done.ended and not done.active:
        error = RunEndedError(
            f"parameter set {done.number} is not active: the loop ended before it became active",
            remedy="start the run again, then repeat rig set",
        )
        error.reported = as_json
        raise error
    if as_json:
        return
    values_text = ", ".join(f"{key} = {value}" for key, value in done.changes.items())
    end = (
        "active"
        if done.active
        else "not active yet: the handle is inside the wall; the set becomes active when the handle leaves it"
    )
    click.echo(f"process {done.pid}, parameter set {done.number}: {values_text}: {end}")
