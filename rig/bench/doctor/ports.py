"""The ports and USB devices that are here, and what costs time or safety on them. Nothing is opened."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rig.bench.doctor.finding import Finding, Outcome
from rig.devices.serial import available_ports, port_facts
from rig.devices.usb import available_devices

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
    facts = port_facts(name)
    found = [_finding(name, sentence) for sentence in facts.problems()]
    return Port(f"serial://{name}", description or facts.product or "", facts.as_mapping()), found


def _finding(name: str, sentence: str) -> Finding:
    """Make a finding of ``what is wrong. Mend it with: command``."""
    text, _, command = sentence.partition(". Mend it with: ")
    return Finding(name=name, outcome=Outcome.PROBLEM, text=text, why=_WHY, command=command)


def _usb_devices() -> list[Port]:
    rigs = [device for device in available_devices() if device.is_rig]
    return [Port(device.url, device.product, {"path": device.path}) for device in rigs]
