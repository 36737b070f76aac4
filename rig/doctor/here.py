"""List what this computer offers for rigs: device backends, ports, USB devices, and rigs that it can simulate.

`rig device list` and the console show the list. This file must not open a port or a device.
"""

from dataclasses import asdict, dataclass
from typing import Any

from rig import devices
from rig.config import presets
from rig.core.present import Item, Row
from rig.devices.port_facts import available_ports
from rig.devices.usb import UsbDevice, available_devices
from rig.doctor._ports import Port, serial_port


@dataclass(frozen=True, slots=True)
class Here:
    """Device backends, ports, USB devices and simulated rigs of this computer.

    Attributes
    ----------
    backends
        Each backend (driver for one URL scheme, such as ``serial``), with the reason why it does not load, or an empty
        text if it loads.
    ports, usb
        Connected serial ports and USB devices; a USB device need not be a rig.
    simulated
        Names of the built-in rigs, which can be simulated.
    """

    backends: tuple[tuple[devices.Backend, str], ...]
    ports: tuple[Port, ...]
    usb: tuple[UsbDevice, ...]
    simulated: tuple[str, ...]

    def as_mapping(self) -> dict[str, Any]:
        """Return the lists of backends, ports, USB devices and simulated rigs as plain values for JSON, by name."""
        return {
            "backends": [{**asdict(one), "broken": broken} for one, broken in self.backends],
            "ports": self.ports,
            "usb": [{"url": device.url, **asdict(device)} for device in self.usb],
            "simulated": self.simulated,
        }

    def items(self) -> list[Item]:
        """Return headings and rows that list backends, serial ports, USB rigs and simulated rigs, for printing."""
        nothing = [Row("none", "")]
        return [
            "backends",
            *(Row(f"{one.scheme}://", _shown(one, broken)) for one, broken in self.backends),
            "serial ports",
            *([Row(port.url, port.description) for port in self.ports] or nothing),
            "USB devices that might be rigs",
            *([Row(device.url, device.product) for device in self.usb if device.is_rig] or nothing),
            "simulated rigs",
            *(Row(f"sim://{name}", "") for name in self.simulated),
        ]


def here() -> Here:
    """List the backends, ports, USB devices and simulated rigs of this computer, without opening a port or a device."""
    return Here(
        backends=tuple((one, devices.broken(one.scheme)) for one in devices.backends()),
        ports=tuple(serial_port(name, text)[0] for name, text in available_ports()),
        usb=tuple(available_devices()),
        simulated=tuple(presets.names()),
    )


def _shown(backend: devices.Backend, broken: str) -> str:
    return f"broken: {broken}" if broken else f"{backend.target} ({backend.distribution})"
