"""The commands ``rig device list``, ``show`` and ``parameters``."""

import click

from rig.cli import _values as values
from rig.cli import options, output
from rig.cli.command import command
from rig.core.present import Row, plain
from rig.devices import open_device
from rig.devices.device_facts import DeviceFacts, active_parameters
from rig.doctor.here import here


@command("list")
@options.json_option
def list_(as_json: bool) -> None:
    """List the backends, serial ports and USB rigs of this computer without opening any."""
    found = here()
    if as_json:
        output.print_json(found)
    else:
        output.show(found.items())


@command()
@click.argument("url", type=values.URL)
@options.json_option
def show(url: str, as_json: bool) -> None:
    """Identify the device at URL: firmware, rig, state, latched fault, clock and port."""
    with open_device(url) as device:
        facts, clock, port = DeviceFacts.of(device), device.drift(), getattr(device.link, "facts", None)
    if as_json:
        output.print_json({**plain(facts), "clock": clock, "port": port})
        return
    output.print_rows([*facts.rows(), *clock.rows()])
    output.print_rows([Row(f"port {name}", value) for name, value in plain(port or {}).items() if value])


@command()
@click.argument("url", type=values.URL)
@options.json_option
def parameters(url: str, as_json: bool) -> None:
    """List every parameter that is active on the device at URL; nothing changes there."""
    with open_device(url) as device:
        active = active_parameters(device)
    if as_json:
        output.print_json(active)
    else:
        output.print_rows(active.rows())
