"""List connected serial ports and USB devices, and their known problems of latency or safety, without opening them."""

from dataclasses import dataclass

from rig.core.answers import question, warning
from rig.core.check import Check
from rig.devices.device import DeviceUrl
from rig.devices.port_facts import PortFacts, available_ports, port_facts
from rig.devices.usb import UsbDevice, available_devices
from rig.doctor._udev import RIGS, udev_rules

NO_PORTS = "ports"  # name of the check that warns where nothing is connected


@dataclass(frozen=True, slots=True)
class Port:
    """A connected serial port or USB device: URL that opens it, description, and facts such as its serial number."""

    url: str
    description: str
    facts: PortFacts | UsbDevice


def ports_here() -> tuple[list[Port], list[Check]]:
    """Return all connected serial ports and USB rigs, and a check for each known problem of a port.

    If nothing is connected, one of the checks warns of it, with the name `NO_PORTS`.
    """
    ports = [serial_port(name, description) for name, description in available_ports()]
    checks = [problem for _, facts in ports for problem in facts.problems()]
    rigs = [Port(device.url, device.product, device) for device in available_devices() if device.is_rig]
    if not ports and not rigs:
        checks.append(_warn_without_port())
    return [*(port for port, _ in ports), *rigs], checks


def serial_port(name: str, description: str = "") -> tuple[Port, PortFacts]:
    """Return the `Port` of the serial port `name` (such as /dev/ttyACM0), and the system's facts about the port."""
    facts = port_facts(name)
    return Port(DeviceUrl.of("serial", name).text, description or facts.product or "", facts), facts


@question(NO_PORTS, "without a rig only simulations can run")
def _warn_without_port() -> Check:
    return warning("no serial port and no USB rig is connected", "connect the rig, then run: rig device list")


def rules_for_rigs() -> str:
    """Return the text of a udev rules file for the USB identifiers of this package's rigs and of the connected rigs."""
    connected = ((device.vid, device.pid) for device in available_devices() if device.is_rig)
    return udev_rules((*RIGS, *connected))
