"""The emulated board as a guest uses it: at the end of a virtio port, plugged into vhci_hcd."""

import contextlib
import json
import os
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from firmware_protocol.messages import USB_PRODUCT, USB_VENDOR
from tests.guest import vhci
from tests.guest.pico import FACTS, PORT, STATUS

PORTS = Path("/sys/class/virtio-ports")
SHARE = Path("/run/guest")
BYTES = 65536


@dataclass(frozen=True, slots=True)
class PluggedPico:
    serial: str

    @property
    def url(self) -> str:
        return f"usb://{USB_VENDOR:04x}:{USB_PRODUCT:04x}/{self.serial}"

    @property
    def tty(self) -> Path | None:
        for device in vhci.devices_with(self.serial):
            for found in device.glob("*:*/tty/*"):
                return Path("/dev") / found.name
        return None

    def status(self) -> dict[str, Any]:
        return dict(json.loads((SHARE / STATUS).read_text()))


def port() -> Path | None:
    for place in PORTS.glob("*"):
        if (place / "name").read_text().strip() == PORT:
            return Path("/dev") / place.name
    return None


@contextlib.contextmanager
def plugged_pico() -> Iterator[PluggedPico]:
    """Plug the board in until the block ends; possible once in the life of a guest."""
    serial = json.loads((SHARE / FACTS).read_text())["serial"]
    path = port()
    assert path is not None
    board = os.open(path, os.O_RDWR)
    kernel, here = socket.socketpair()
    for source, target in (
        (lambda: os.read(board, BYTES), here.sendall),
        (lambda: here.recv(BYTES), lambda data: _write(board, data)),
    ):
        threading.Thread(target=_carry, args=(source, target), daemon=True).start()
    place = vhci.attach(kernel)
    kernel.close()
    try:
        vhci.wait_for_device(serial)
        yield PluggedPico(serial)
    finally:
        here.shutdown(socket.SHUT_RDWR)
    vhci.wait_for_free(place)
    vhci.wait_for_no_device(serial)


def _write(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


def _carry(source: Any, target: Any) -> None:
    """Copy bytes in one direction until either end is closed."""
    with contextlib.suppress(OSError):
        while data := source():
            target(data)
