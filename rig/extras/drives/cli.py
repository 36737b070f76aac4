"""Commands ``rig serve moteus`` and ``rig serve odrive``: run firmware (a bridge) in front of a drive.

Drive and firmware together appear as one device at a port.
"""

import shlex
import sys
from collections.abc import Callable

import click

from rig import config
from rig.cli import options, output
from rig.cli.command import command
from rig.config import presets
from rig.core.this_system import refuse_real_time
from rig.devices.device import DeviceUrl

if sys.platform == "linux":
    from rig.extras.drives.describe import text
    from rig.extras.drives.serve import Found, look, serve

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


def _bridge_options(numbers: click.IntRange, default: int, called: str) -> Callable[[options.F], options.F]:
    return options.added(
        options.rig_option(given=True),
        click.option(
            "--id", "drive", type=numbers, default=default, show_default=True, help=f"The drive's {called}."
        ),
        click.option(
            "--describe",
            is_flag=True,
            help="Print an experiment file to start from, with the values that the drive reports.",
        ),
        options.json_option,
    )


def _run(url: DeviceUrl, preset: str, *, describe: bool, as_json: bool) -> None:
    refuse_real_time("a bridge", "let a board drive the motor")
    if sys.platform == "linux":
        if describe:
            click.echo(text(look(url), url.text), nl=False)
        else:
            _serve(url, preset, as_json=as_json)


@command()
@click.argument("place", metavar="PORT")
@_bridge_options(click.IntRange(1, 127), 1, "id")
@click.option(
    "--baud", type=click.IntRange(300, 20_000_000), help="Baud rate, for a serial adapter. [921600]"
)
def moteus(place: str, preset: str, drive: int, baud: int | None, describe: bool, as_json: bool) -> None:
    """Run the bridge to a moteus; print the port to open. Ctrl-C ends it.

    PORT is that of an fdcanusb or mjcanfd-usb-1x, such as /dev/fdcanusb, or a CAN interface, such as can0. For one run
    no bridge is needed: `--url moteus:///dev/fdcanusb` starts one.
    """
    chosen = {"id": str(drive)} | ({} if baud is None else {"baud": str(baud)})
    _run(DeviceUrl.of("moteus", place, chosen), preset, describe=describe, as_json=as_json)


@command()
@click.argument("place", metavar="INTERFACE")
@_bridge_options(click.IntRange(0, 62), 0, "node")
@click.option(
    "--endpoints",
    type=click.Path(exists=True, dir_okay=False),
    required=True,
    help="The manufacturer's flat_endpoints.json for the drive's firmware: it has the numbers of the "
    "parameters.",
)
def odrive(place: str, preset: str, drive: int, endpoints: str, describe: bool, as_json: bool) -> None:
    """Run the bridge to an ODrive; print the port to open. Ctrl-C ends it.

    INTERFACE is a CAN interface of Linux, such as can0. For one run no bridge is needed: `--url
    'odrive://can0?endpoints=flat_endpoints.json'` starts one.
    """
    chosen = {"id": str(drive), "endpoints": endpoints}
    _run(DeviceUrl.of("odrive", place, chosen), preset, describe=describe, as_json=as_json)
