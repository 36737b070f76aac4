"""``rig bridge``."""

from __future__ import annotations

import shlex
import sys

import click

from rig import config
from rig.cli import options, output
from rig.cli.command import Group
from rig.config import presets
from rig.core.this_system import refuse_real_time
from rig.devices.device import DeviceUrl

if sys.platform == "linux":
    from rig.bench.bridge.describe import text
    from rig.bench.bridge.serve import Found, look, serve

    def _serve(url: DeviceUrl, preset: str, *, as_json: bool) -> None:
        experiment = presets.load_named(preset)

        def announce(port: str, found: Found) -> None:
            if as_json:
                output.print_json(
                    {"url": f"serial://{port}", "rig": experiment.rig.name, "drive": found.drive.settings}
                )
            else:
                click.echo(f"serial://{port}")
                output.note(
                    f"{found.drive.firmware}, id {found.drive.id}, is the rig {experiment.rig.name}; try: rig doctor "
                    f"--url serial://{shlex.quote(port)}"
                )
            for message in found.messages:
                click.echo(message, err=True)

        serve(url, config.rig_model(experiment), announce=announce)


@click.group(cls=Group)
def bridge() -> None:
    """Drives that people already own, as devices."""


@bridge.command()
@click.argument("place", metavar="PORT")
@options.rig_option(given=True)
@click.option(
    "--id", "drive", type=click.IntRange(1, 127), default=1, show_default=True, help="The drive's id."
)
@click.option(
    "--baud", type=click.IntRange(300, 20_000_000), help="Of a serial adapter that has one. [921600]"
)
@click.option(
    "--describe",
    is_flag=True,
    help="Print an experiment file to start from, with what the drive tells of itself.",
)
@options.json_option
def moteus(place: str, preset: str, drive: int, baud: int | None, describe: bool, as_json: bool) -> None:
    """Run the bridge to a moteus; prints the port to open. Ctrl-C ends it.

    PORT is that of an fdcanusb or mjcanfd-usb-1x, such as /dev/fdcanusb, or a CAN interface, such as can0. For one run
    no bridge is needed: `--url moteus:///dev/fdcanusb` starts one.
    """
    refuse_real_time("a bridge", "let a board drive the motor")
    chosen = {"id": str(drive)} | ({} if baud is None else {"baud": str(baud)})
    url = DeviceUrl("moteus", place, chosen, f"moteus://{place}")
    if sys.platform == "linux":
        if describe:
            click.echo(text(look(url), place), nl=False)
        else:
            _serve(url, preset, as_json=as_json)
