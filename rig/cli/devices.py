"""``rig devices``."""

from __future__ import annotations

from dataclasses import asdict

import click

from rig import devices as table
from rig.bench.doctor.ports import serial_port
from rig.cli import options, output
from rig.config import presets
from rig.core.present import Row, plain
from rig.devices import open_device
from rig.devices.device_facts import DeviceFacts
from rig.devices.serial import available_ports
from rig.devices.usb import available_devices


@click.command()
@click.argument("url", required=False)
@options.json_option
def devices(url: str | None, as_json: bool) -> None:
    """List the backends, serial ports and USB rigs of this computer, or identify the device at URL."""
    if url:
        _identify(url, as_json)
    else:
        _list(as_json)


def _identify(url: str, as_json: bool) -> None:
    with open_device(url) as device:
        facts, clock, port = DeviceFacts.of(device), device.drift(), getattr(device.link, "facts", None)
    if as_json:
        output.print_json({**plain(facts), "clock": clock, "port": port})
        return
    output.print_rows([*facts.rows(), *clock.rows()])
    output.print_rows([Row(f"port {name}", value) for name, value in plain(port or {}).items() if value])


def _list(as_json: bool) -> None:
    backends, rigs = table.backends(), presets.names()
    ports = [serial_port(name, text)[0] for name, text in available_ports()]
    usb = available_devices()
    if as_json:
        found = [{"url": device.url, **asdict(device)} for device in usb]
        shown = [{**asdict(one), "broken": table.broken(one.scheme)} for one in backends]
        output.print_json({"backends": shown, "ports": ports, "usb": found, "simulated": rigs})
        return
    nothing = [Row("none", "")]
    output.show(
        [
            "backends",
            *(Row(f"{one.scheme}://", _shown(one)) for one in backends),
            "serial ports",
            *([Row(port.url, port.description) for port in ports] or nothing),
            "USB devices that could be rigs",
            *([Row(device.url, device.product) for device in usb if device.is_rig] or nothing),
            "simulated rigs",
            *(Row(f"sim://{name}", "") for name in rigs),
        ]
    )


def _shown(backend: table.Backend) -> str:
    broken = table.broken(backend.scheme)
    return f"broken: {broken}" if broken else f"{backend.target} ({backend.distribution})"
