"""USB devices on the virtual bus as context managers: a bare one that a test controls, and a simulated rig."""

import contextlib
import socket
from collections.abc import Iterator
from dataclasses import dataclass

from firmware_protocol.messages import USB_PRODUCT, USB_VENDOR
from rig.core.model import RigModel
from sim_backend.ends.usb import UsbPort, UsbShape
from tests.guest import vhci
from tests.guest.far_end import FarEnd, far_end
from tests.guest.usbip import Bus


@dataclass(slots=True)
class Plugged:
    """A device on the bus: `bus` injects faults, `device` is the device's end of the two pipes."""

    serial: str
    bus: Bus
    port: int
    device: socket.socket
    far_end: FarEnd | None = None

    @property
    def url(self) -> str:
        return f"usb://{USB_VENDOR:04x}:{USB_PRODUCT:04x}/{self.serial}"

    def unplug(self) -> None:
        self.bus.unplug()
        vhci.wait_for_free(self.port)
        vhci.wait_for_no_device(self.serial)


def pipes() -> tuple[socket.socket, socket.socket]:
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


@contextlib.contextmanager
def plugged(serial: str, ends: tuple[socket.socket, socket.socket] | None = None) -> Iterator[Plugged]:
    """Plug in a device that sends nothing; the test has its end of the pipes."""
    near, device = ends or pipes()
    shape = UsbShape(serial=serial)
    kernel, host = socket.socketpair()
    bus = Bus(host, near, shape)
    bus.start()
    with near, device:
        try:
            port = vhci.attach(kernel)
            kernel.close()
            vhci.wait_for_device(serial)
            yield Plugged(serial, bus, port, device)
        finally:
            bus.unplug()
        vhci.wait_for_free(port)
        vhci.wait_for_no_device(serial)


@contextlib.contextmanager
def plugged_rig(serial: str, model: RigModel) -> Iterator[Plugged]:
    near, device = pipes()
    with far_end(model, lambda: UsbPort(device)) as end, plugged(serial, (near, device)) as made:
        made.far_end = end
        yield made
