"""``rig devices``."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import click

from rig import devices as table
from rig.cli import options, output
from rig.config import presets
from rig.core.present import Row
from rig.devices import open_device
from rig.devices.serial import available_ports
from rig.devices.usb import available_devices

EXCHANGES, EXCHANGES_S = 20, 1.0  # of the clocks: enough for the drift to a few ppm
VIRTUAL_S = 0.1  # where time costs computing, and nothing disturbs an exchange


@click.command()
@click.argument("url", required=False)
@options.json_option
def devices(url: str | None, as_json: bool) -> None:
    """List the backends, serial ports and USB rigs here, or ask the device at URL who it is."""
    facts = _ask(url) if url else _list()
    if as_json:
        output.print_json(facts)
        return
    if url:
        port, problems, clock = facts.pop("port"), facts.pop("problems"), facts.pop("clock")
        output.print_rows([*(Row(name, value) for name, value in facts.items()), *clock.rows()])
        output.print_rows([Row(f"port {name}", str(value)) for name, value in (port or {}).items() if value])
        for problem in problems:
            click.echo(f"rig: {problem}", err=True)
        return
    click.echo("backends")
    output.print_pairs(
        [(f"{b['scheme']}://", f"{b['target']} ({b['distribution']})") for b in facts["backends"]]
    )
    click.echo("serial ports")
    output.print_pairs([(p["port"], p["description"]) for p in facts["ports"]] or [("none", "")])
    click.echo("USB devices that could be rigs")
    output.print_pairs([(u["url"], u["product"]) for u in facts["usb"] if u["is_rig"]] or [("none", "")])
    click.echo("simulated rigs")
    output.print_pairs([(f"sim://{name}", "") for name in facts["simulated"]])


def _list() -> dict[str, Any]:
    return {
        "backends": [asdict(backend) for backend in table.backends()],
        "ports": [{"port": port, "description": text} for port, text in available_ports()],
        "usb": [{"url": device.url, **asdict(device)} for device in available_devices()],
        "simulated": presets.names(),
    }


def _ask(url: str) -> dict[str, Any]:
    with open_device(url) as device:
        dictionary = device.dictionary
        clock = device.clock(EXCHANGES, over_s=VIRTUAL_S if device.link.clock.virtual else EXCHANGES_S)
        fault = device.fault_report() if device.connection.state.name == "FAULT" else None
        return {
            "url": url,
            "device": dictionary.device,
            "firmware": dictionary.firmware,
            "simulated": dictionary.simulated,
            "protocol": f"{dictionary.major}.{dictionary.minor}",
            "state": device.connection.state.name,
            "fault": None if fault is None else f"{fault.text}; {fault.remedy}",
            "current_quantum_a": dictionary.current_quantum_a,
            "position_rate_default": dictionary.position_rate_default,
            "position_rate_maximum": dictionary.position_rate_maximum,
            "clock": clock,
            **_port(device.link),
        }


def _port(link: Any) -> dict[str, Any]:
    """What a link knows of its port and could not obtain there; the in-memory link has none."""
    facts = getattr(link, "facts", None)
    return {
        "port": None if facts is None else facts.as_mapping(),
        "problems": list(link.messages),
    }
