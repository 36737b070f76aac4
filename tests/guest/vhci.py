"""The kernel's virtual host controller: attach the device behind a socket, wait for it to appear and disappear."""

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
    return (CONTROLLER / "attach").exists()


def attach(end: socket.socket) -> int:
    """Attach the device behind a stream socket and return its port.

    The caller may close `end` afterwards: the kernel has its own reference to the socket.
    """
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
    wait_until(
        f"port {port} is free",
        lambda: re.search(rf"^hs\s+0*{port}\s+0*{FREE}\s", (CONTROLLER / "status").read_text(), re.M),
    )


def devices_with(serial: str) -> list[Path]:
    found = []
    for path in DEVICES.glob("*/serial"):
        try:
            if path.read_text().strip() == serial:
                found.append(path.parent)
        except OSError:  # unplugged between the listing and the reading
            continue
    return found


def wait_for_device(serial: str) -> None:
    wait_until(
        f"device {serial} is enumerated",
        lambda: any((path / "bConfigurationValue").exists() for path in devices_with(serial)),
    )
    settle()


def wait_for_no_device(serial: str) -> None:
    wait_until(f"device {serial} is gone", lambda: not devices_with(serial))
    settle()


def settle() -> None:
    """Wait for udev, which libusb and symbolic links follow."""
    subprocess.run(["udevadm", "settle", f"--timeout={WAIT_S:.0f}"], check=True)


def wait_until(what: str, condition: Callable[[], object]) -> None:
    """Poll a condition until it is true; `TimeoutError` names it after `WAIT_S`."""
    # Polled, because sysfs has no events.
    deadline = time.monotonic() + WAIT_S
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f"not within {WAIT_S:g} s: {what}")
        time.sleep(0.02)
