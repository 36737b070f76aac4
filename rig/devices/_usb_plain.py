"""Transfer bytes of a USB device by pyusb's own calls, if compiled code cannot use libusb (`_usb_handle`).

A busy Python interpreter then delays the loop (see `rig.devices._threaded`); the link's `note` warns of this.
`rig.devices.usb` uses it. It must not be used while the queue of `_usb_queue` works.
"""

import errno
import time

import usb.core

from rig.devices._failures import EREMOTEIO
from rig.devices._threaded import WAIT_S, ThreadedLine

WRITE_TIMEOUT_MS = 5  # for one write of the loop
OUT_LIMIT_S = 0.5


class PlainTransfers(ThreadedLine):
    """The two bulk endpoints of a USB interface by pyusb's own calls, read by a Python thread."""

    def __init__(
        self, device: usb.core.Device, endpoint_in: int, endpoint_out: int, packet: int, why: str
    ) -> None:
        super().__init__()
        self.note = f"USB transfers run in the Python interpreter, which may delay the loop: {why}"
        self._device = device
        self._in, self._out, self._packet = endpoint_in, endpoint_out, packet
        self._blocked_since: float | None = None
        self.start()

    def receive(self) -> bytes:
        """Return one packet of the USB device; empty if none arrives within `WAIT_S` (50 ms)."""
        try:
            return bytes(self._device.read(self._in, self._packet, round(WAIT_S * 1e3)))
        except usb.core.USBTimeoutError:
            return b""

    def send(self, data: bytes) -> int:
        """Write once; return the number of accepted bytes. `OSError` if none for 0.5 s, or only a part of a packet."""
        try:
            sent = int(self._device.write(self._out, data, WRITE_TIMEOUT_MS))
        except usb.core.USBTimeoutError:
            now = time.monotonic()
            self._blocked_since = self._blocked_since or now
            if now - self._blocked_since > OUT_LIMIT_S:
                raise OSError(
                    errno.ETIMEDOUT, f"the USB device accepts nothing for {OUT_LIMIT_S} s"
                ) from None
            return 0
        self._blocked_since = None
        if sent < len(data) and sent % self._packet:  # a time-out falls between packets
            raise OSError(EREMOTEIO, "the USB device accepted only a part of a packet")
        return sent
