"""The bulk pipes of a USB device through pyusb's own calls: for backends whose handles cannot be reached.

The contracts are those of `rig.devices.usb_transfers`, the price is another: a thread of Python reads, the plugs of
the loop are callbacks, and both need the GIL. A busy interpreter delays the loop then by milliseconds, which the
ledger shows; the link says so in `note`.
"""

from __future__ import annotations

import ctypes
import errno
import threading
import time
from collections.abc import Callable
from typing import Any

import usb.core

from rig.realtime.plugs import TRANSFER_SIGNATURE, WAIT_SIGNATURE, NativeFunction

READ_TIMEOUT_MS = 50  # of one call of the reader: how soon it sees that it shall end
WRITE_TIMEOUT_MS = 5  # of one write of the loop
OUT_LIMIT_S = 0.5
CLOSE_S = 2.0
PENDING_BYTES = 65536
_TRANSFER = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)
_WAIT = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)


class PlainTransfers:
    """The pipes of one interface. Errors are bare `OSError` with the numbers of `rig.devices.failures`."""

    def __init__(
        self, device: usb.core.Device, endpoint_in: int, endpoint_out: int, packet: int, why: str
    ) -> None:
        self.note = f"USB through Python calls, which share the interpreter with everything else: {why}"
        self._device = device
        self._in, self._out, self._packet = endpoint_in, endpoint_out, packet
        self._pending = bytearray()
        self._error = 0
        self._closing = False
        self._changed = threading.Condition()
        self._blocked_since: float | None = None
        self._plugs: tuple[Any, Any, Any, int] | None = None
        self._reader = threading.Thread(target=self._fetch, name="rig-usb-reader", daemon=True)
        self._reader.start()

    def _fetch(self) -> None:
        """Read packets until closed or broken."""
        while not self._closing:
            data, error = b"", 0
            try:
                data = self._device.read(self._in, self._packet, READ_TIMEOUT_MS).tobytes()
            except usb.core.USBTimeoutError:
                continue
            except (usb.core.USBError, OSError) as failed:
                error = failed.errno or errno.EIO
            with self._changed:
                while len(self._pending) > PENDING_BYTES and not self._closing:
                    self._changed.wait(READ_TIMEOUT_MS * 1e-3)
                self._pending += data
                self._error = error
                self._changed.notify_all()
            if error:
                return

    def _ready(self, timeout_s: float) -> int:
        """Wait for bytes: 1, 0 at the time-out, negative errno."""
        with self._changed:
            self._changed.wait_for(lambda: self._pending or self._error, max(0.0, timeout_s))
            return 1 if self._pending else -self._error

    def _take(self, size: int) -> bytes:
        with self._changed:
            data = bytes(self._pending[:size])
            del self._pending[:size]
            self._changed.notify_all()
        return data

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived, waiting at most `timeout_s` for the first byte."""
        ready = self._ready(timeout_s)
        if ready < 0:
            raise OSError(-ready, "bulk read")
        return self._take(PENDING_BYTES)

    def write(self, data: bytes) -> None:
        """Give all of `data` to the device."""
        while data:
            data = data[self._send(data) :]

    def _send(self, data: bytes) -> int:
        """Write once, for a few milliseconds: bytes taken; a device that takes none for long raises ETIMEDOUT."""
        try:
            sent = int(self._device.write(self._out, data, WRITE_TIMEOUT_MS))
        except usb.core.USBTimeoutError:
            now = time.monotonic()
            self._blocked_since = self._blocked_since or now
            if now - self._blocked_since > OUT_LIMIT_S:
                raise OSError(errno.ETIMEDOUT, "bulk write") from None
            return 0
        self._blocked_since = None
        if sent < len(data) and sent % self._packet:  # a time-out falls between packets
            raise OSError(errno.EREMOTEIO, "bulk write")
        return sent

    def plugs(self) -> tuple[Any, Any, Any, int]:
        """Return read, write, wait and their handle (`rig.devices.port.LoopPort`)."""

        def native(kind: Any, function: Callable[..., int], signature: Any) -> Any:
            callback = kind(_guarded(function))
            return NativeFunction(ctypes.cast(callback, ctypes.c_void_p).value or 0, signature, keep=callback)

        if self._plugs is None:
            self._plugs = (
                native(_TRANSFER, self._plug_read, TRANSFER_SIGNATURE),
                native(_TRANSFER, self._plug_write, TRANSFER_SIGNATURE),
                native(_WAIT, self._plug_wait, WAIT_SIGNATURE),
                0,
            )
        return self._plugs

    def _plug_read(self, handle: int, address: int, size: int) -> int:
        ready = self._ready(0.0)
        if ready <= 0:
            return ready
        data = self._take(size)
        ctypes.memmove(address, data, len(data))
        return len(data)

    def _plug_write(self, handle: int, address: int, size: int) -> int:
        return self._send(ctypes.string_at(address, size)) if size > 0 else 0

    def _plug_wait(self, handle: int, deadline_ns: int) -> int:
        while True:
            remaining_ns = deadline_ns - time.monotonic_ns()
            ready = self._ready(remaining_ns * 1e-9)
            if ready or remaining_ns <= 0:
                return ready

    def close(self) -> None:
        """End the reader; may be called twice."""
        self._closing = True
        with self._changed:
            self._changed.notify_all()
        self._reader.join(CLOSE_S)


def _guarded(function: Callable[..., int]) -> Callable[..., int]:
    """Wrap a callback so that nothing escapes into compiled code: what goes wrong becomes a negative errno."""

    def call(*arguments: int) -> int:
        try:
            return function(*arguments)
        except OSError as error:
            return -(error.errno or errno.EIO)
        except Exception:
            return -errno.EIO

    return call
