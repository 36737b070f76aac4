"""The command ``rig serve rig``."""

from typing import Any

import click

from rig import config
from rig.cli import options, output
from rig.cli.command import command, option
from rig.config import presets
from rig.devices.local import serve as serve_here
from rig.realtime.scheduling import Realtime


@command("rig")
@options.rig_option(given=True)
@option(
    "--rate",
    type=options.Hertz(50, 20_000),
    help="Highest rate that the device reports: 50 to 4000 Hz, with --firmware up to 20000 Hz. [1000]",
)
@click.option(
    "--firmware",
    is_flag=True,
    help="Serve the firmware, compiled for this machine: it can run the law itself.",
)
@options.seed_option("Seed of the sensor noise.", default=0, show_default=True)
@options.json_option
def serve(preset: str, rate: int | None, firmware: bool, seed: int, as_json: bool) -> None:
    """Run a simulated rig in real time behind a pseudo-terminal, and print the port to open. Ctrl-C ends it."""
    experiment = presets.load_named(preset)

    def announce(port: str) -> None:
        if as_json:
            output.print_json({"url": f"serial://{port}", "rig": experiment.rig.name})
        else:
            click.echo(f"serial://{port}")
            output.note(f"{experiment.rig.name} is simulated there; try: rig hit --url serial://{port}")

    def scheduled(granted: Realtime) -> None:
        obtained = granted.report["obtained"]
        locked = "its memory locked" if obtained["locked_bytes"] else "its memory not locked"
        output.note(f"scheduled as {obtained['policy']} {obtained['priority']}, {locked}")
        for message in granted.messages:
            click.echo(message, err=True)

    chosen: dict[str, Any] = {} if rate is None else {"rate": rate}
    chosen |= {"firmware": True} if firmware else {}
    serve_here(config.rig_model(experiment), seed=seed, announce=announce, scheduled=scheduled, **chosen)
