"""The ports and USB devices that are here, and what costs time or safety on them. Nothing is opened."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from rig.devices.serial import available_ports
from rig.doctor.finding import Finding, Outcome

_WHY = "a port that keeps bytes back delays every command; one that others can open loses some"


@dataclass(frozen=True, slots=True)
class Port:
    """A way to a device: the URL that opens it, what it says of itself, and all that is known of it."""

    url: str
    description: str
    facts: dict[str, Any]

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {"url": self.url, "description": self.description, "facts": self.facts}


def ports_here() -> tuple[list[Port], list[Finding]]:
    """List serial ports and USB devices, with a finding for each thing that is wrong with one."""
    ports: list[Port] = []
    findings: list[Finding] = []
    for name, description in available_ports():
        port, found = look_at_port(name, description)
        ports.append(port)
        findings += found
    ports += _usb_devices()
    if not ports:
        findings.append(
            Finding(
                name="ports",
                outcome=Outcome.WARNING,
                text="no serial port and no USB rig is here",
                why="without one there is nothing to run on but the simulation",
                command="plug the rig in, then: rig devices",
            )
        )
    return ports, findings


def look_at_port(name: str, description: str = "") -> tuple[Port, list[Finding]]:
    """What is known of one serial port, and what is wrong with it."""
    look = getattr(import_module("rig.devices.serial"), "port_facts", None)
    if look is None:
        return Port(f"serial://{name}", description, {}), []
    facts = look(name)
    found = [_finding(name, sentence) for sentence in facts.problems()]
    return Port(f"serial://{name}", description or facts.product or "", facts.as_mapping()), found


def _finding(name: str, sentence: str) -> Finding:
    """Make a finding of ``what is wrong. Mend it with: command``."""
    text, _, command = sentence.partition(". Mend it with: ")
    return Finding(name=name, outcome=Outcome.PROBLEM, text=text, why=_WHY, command=command)


def _usb_devices() -> list[Port]:
    try:
        usb = import_module("rig.devices.usb")
    except ImportError:  # no libusb here
        return []
    found = []
    for device in usb.available_devices():
        serial = getattr(device, "serial", None) or ""
        url = f"usb://{device.vid:04x}:{device.pid:04x}" + (f"/{serial}" if serial else "")
        said = getattr(device, "product", None) or ""
        if getattr(device, "is_rig", True):
            found.append(Port(url, str(said), {"path": str(getattr(device, "path", ""))}))
    return found
