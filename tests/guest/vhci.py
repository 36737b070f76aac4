"""The kernel's virtual host controller: attach the device at the other end of a socket, wait for it to come and go."""

from __future__ import annotations

import re
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
DEVICES = Path("/sys/bus/usb/devices")
FULL_SPEED = 2  # enum usb_device_speed
FREE = 4  # VDEV_ST_NULL
WAIT_S = 30.0
DEVICE_ID = 0x10001  # bus and number at the far end; any will do


def is_here() -> bool:
    """Return True if this kernel has the controller and it may be used."""
    return (CONTROLLER / "attach").exists()


def attach(end: socket.socket) -> int:
    """Attach the device behind a stream socket and return its port; afterwards `end` may be closed."""
    port = free_port()
    (CONTROLLER / "attach").write_text(f"{port} {end.fileno()} {DEVICE_ID} {FULL_SPEED}")
    return port


def free_port() -> int:
    """Return a port of the controller's USB 2 hub with nothing on it."""
    for line in (CONTROLLER / "status").read_text().splitlines():
        match = re.match(r"hs\s+(\d+)\s+(\d+)", line)
        if match and int(match[2]) == FREE:
            return int(match[1])
    raise RuntimeError("every port of vhci_hcd is taken")


def wait_for_free(port: int) -> None:
    """Wait until a port of the controller is free."""
    wait_until(lambda: re.search(rf"^hs\s+0*{port}\s+0*{FREE}\s", (CONTROLLER / "status").read_text(), re.M))


def devices_with(serial: str) -> list[Path]:
    """Devices on the bus with this serial number, in sysfs."""
    found = []
    for path in DEVICES.glob("*/serial"):
        try:
            if path.read_text().strip() == serial:
                found.append(path.parent)
        except OSError:  # it goes just now
            continue
    return found


def wait_for_device(serial: str) -> None:
    """Wait until a device is enumerated and udev has handled it."""
    wait_until(lambda: any((path / "bConfigurationValue").exists() for path in devices_with(serial)))
    settle()


def wait_for_no_device(serial: str) -> None:
    """Wait until a device is gone and udev has handled that."""
    wait_until(lambda: not devices_with(serial))
    settle()


def settle() -> None:
    """Wait for udev, which libusb and symbolic links follow."""
    subprocess.run(["udevadm", "settle", f"--timeout={WAIT_S:.0f}"], check=True)


def wait_until(condition: Callable[[], object]) -> None:
    """Poll a condition for 30 s at most: sysfs has no events."""
    deadline = time.monotonic() + WAIT_S
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError("it did not happen within 30 s")
        time.sleep(0.02)
