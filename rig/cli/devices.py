"""``rig devices``."""

from __future__ import annotations

import click

from rig.bench.doctor.here import here
from rig.cli import options, output
from rig.core.present import Row, plain
from rig.devices import open_device
from rig.devices.device_facts import DeviceFacts


@click.command()
@click.argument("url", required=False)
@options.json_option
def devices(url: str | None, as_json: bool) -> None:
    """List the backends, serial ports and USB rigs of this computer, or identify the device at URL."""
    if url:
        _identify(url, as_json)
    else:
        found = here()
        if as_json:
            output.print_json(found)
        else:
            output.show(found.items())


def _identify(url: str, as_json: bool) -> None:
    with open_device(url) as device:
        facts, clock, port = DeviceFacts.of(device), device.drift(), getattr(device.link, "facts", None)
    if as_json:
        output.print_json({**plain(facts), "clock": clock, "port": port})
        return
    output.print_rows([*facts.rows(), *clock.rows()])
    output.print_rows([Row(f"port {name}", value) for name, value in plain(port or {}).items() if value])
