"""List what this computer offers for rigs: backends, ports, USB devices, and rigs that it can simulate.

`rig device list` and the console show it. It must not open a port or a device.
"""

from __future__ import annotations

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
    """Backends, ports, USB devices and simulated rigs of this computer.

    Attributes
    ----------
    backends
        Each backend with the reason why it does not load; the reason is empty if it loads.
    ports, usb
        Connected serial ports and USB devices; a USB device may be something other than a rig.
    simulated
        Names of built-in rigs.
    """

    backends: tuple[tuple[devices.Backend, str], ...]
    ports: tuple[Port, ...]
    usb: tuple[UsbDevice, ...]
    simulated: tuple[str, ...]

    def as_mapping(self) -> dict[str, Any]:
        """Return the lists as plain values for JSON."""
        return {
            "backends": [{**asdict(one), "broken": broken} for one, broken in self.backends],
            "ports": self.ports,
            "usb": [{"url": device.url, **asdict(device)} for device in self.usb],
            "simulated": self.simulated,
        }

    def items(self) -> list[Item]:
        """Return the lists as items to print."""
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
    """List backends, ports, USB devices and simulated rigs without opening a port or a device."""
    return Here(
        backends=tuple((one, devices.broken(one.scheme)) for one in devices.backends()),
        ports=tuple(serial_port(name, text)[0] for name, text in available_ports()),
        usb=tuple(available_devices()),
        simulated=tuple(presets.names()),
    )


def _shown(backend: devices.Backend, broken: str) -> str:
    return f"broken: {broken}" if broken else f"{backend.target} ({backend.distribution})"
