"""A USB serial port (CDC ACM) of the kernel at both ends: dummy_hcd as the bus, a configfs gadget as the device.

The host has ``/dev/ttyACM*``, as of any board, the device ``/dev/ttyGS0``: see the kernel's
Documentation/usb/gadget_configfs.rst and gadget_serial.rst.
"""

import contextlib
import errno
import os
import select
import termios
import time
import tty
from collections.abc import Iterator
from pathlib import Path

from sim_backend.ends.real_time import sleep_until

CONFIGFS = Path("/sys/kernel/config")
CONTROLLERS = Path("/sys/class/udc")
DEVICE_END = Path("/dev/ttyGS0")
VENDOR, PRODUCT = 0x1209, 0x0002
READ_BYTES = 4096
PENDING_BYTES = 8192


def is_here() -> bool:
    return (CONFIGFS / "usb_gadget").exists() and any(CONTROLLERS.iterdir())


class AcmGadget:
    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._controller = next(iter(CONTROLLERS.iterdir())).name

    def plug(self) -> None:
        (self._directory / "UDC").write_text(self._controller)

    def pull(self) -> None:
        with contextlib.suppress(OSError):  # ENODEV: it is out
            (self._directory / "UDC").write_text("\n")


@contextlib.contextmanager
def acm_gadget(serial: str) -> Iterator[AcmGadget]:
    """Make a gadget with one ACM function, not plugged in yet."""
    place = CONFIGFS / "usb_gadget" / f"rig-{serial}"
    configuration, function = place / "configs" / "c.1", place / "functions" / "acm.0"
    texts, named = place / "strings" / "0x409", configuration / "strings" / "0x409"
    made = (place, texts, configuration, named, function)
    for directory in made:
        directory.mkdir()
    link = configuration / "acm.0"
    for file, text in (
        (place / "idVendor", f"{VENDOR:#06x}"),
        (place / "idProduct", f"{PRODUCT:#06x}"),
        (texts / "manufacturer", "haptic-rig"),
        (texts / "product", "simulated rig"),
        (texts / "serialnumber", serial),
        (named / "configuration", "ACM"),
    ):
        file.write_text(text)
    link.symlink_to(function)
    gadget = AcmGadget(place)
    try:
        yield gadget
    finally:
        gadget.pull()
        link.unlink()
        for directory in (named, configuration, function, texts, place):
            directory.rmdir()


class GadgetPort:
    """The device's end of the gadget's line, as a `ends.real_time.DevicePort`; it is reopened after an unplug."""

    def __init__(self) -> None:
        self._descriptor = -1
        self._pending = b""

    def read(self, deadline_ns: int) -> bytes:
        """Wait until the deadline for bytes of the host; return them or nothing."""
        if self._descriptor < 0 and not self._open():
            sleep_until(deadline_ns)
            return b""
        remaining_s = max(0, deadline_ns - time.monotonic_ns()) * 1e-9
        readable, _, _ = select.select([self._descriptor], [], [], remaining_s)
        if not readable:
            return b""
        try:
            data = os.read(self._descriptor, READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._close()
        return data

    def write(self, frames: bytes) -> None:
        """Send replies, at once or as the host reads them; drop them beyond `PENDING_BYTES`."""
        if self._descriptor < 0 or len(self._pending) + len(frames) > PENDING_BYTES:
            return
        self._pending += frames
        try:
            while self._pending:
                self._pending = self._pending[os.write(self._descriptor, self._pending) :]
        except BlockingIOError:
            return
        except OSError as error:
            if error.errno != errno.EAGAIN:
                self._close()

    def write_if_free(self, frame: bytes) -> None:
        """Send a frame, or drop it while older ones wait."""
        if self._pending:
            self.write(b"")
        if not self._pending:
            self.write(frame)

    def _open(self) -> bool:
        try:
            self._descriptor = os.open(DEVICE_END, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(self._descriptor, termios.TCSANOW)
        except (OSError, termios.error):
            self._close()
        return self._descriptor >= 0

    def _close(self) -> None:
        self._pending = b""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
