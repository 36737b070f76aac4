"""Link whose bytes a Python thread reads, for ports that compiled code cannot access directly.

The loop's functions are Python callbacks with the arguments and results of `rig.realtime.system.descriptor_read`,
`descriptor_write` and `descriptor_wait`. Thread and callbacks need the GIL, so a busy interpreter delays a loop by
milliseconds, which the latency ledger (five time stamps in each recorded row) shows. `_threaded_serial` and
`_usb_plain` inherit from it. Only the thread may read the port.
"""

import errno
import threading
import time

from rig.realtime.callbacks import CallbackPlugs, callback_plugs

WAIT_S = 0.05  # longest wait of the reader, which then checks whether it must end
CLOSE_S = 2.0
PENDING_BYTES = 65536


class ThreadedLine:
    """Base of links that a Python thread reads; a subclass implements `receive` and `send`, and calls `start`.

    A failure is an `OSError` with an errno, which `rig.devices._failures` explains.
    """

    def __init__(self) -> None:
        self._pending = bytearray()
        self._error = 0
        self._closing = False
        self._changed = threading.Condition()
        self._plugs: CallbackPlugs | None = None
        self._reader = threading.Thread(target=self._fetch, name="rig-reader", daemon=True)

    def start(self) -> None:
        """Start the thread that reads the port into a buffer."""
        self._reader.start()

    def receive(self) -> bytes:
        """Return the bytes that have arrived at the port; wait at most `WAIT_S` (50 ms). Raise `OSError` on failure."""
        raise NotImplementedError

    def send(self, data: bytes) -> int:
        """Write to the port once; return the number of accepted bytes. Raise `OSError` after a write timeout."""
        raise NotImplementedError

    def _fetch(self) -> None:
        """Read the port into the buffer until the port is closed or fails; store the errno of a failure."""
        while not self._closing:
            data, error = b"", 0
            try:
                data = self.receive()
            except OSError as failed:
                error = failed.errno or errno.EIO
            if not (data or error):
                continue
            with self._changed:
                while len(self._pending) > PENDING_BYTES and not self._closing:
                    self._changed.wait(WAIT_S)
                self._pending += data
                self._error = error
                self._changed.notify_all()
            if error:
                return

    def _ready(self, timeout_s: float) -> bool:
        """Return True if bytes arrive within `timeout_s` (s); if the reader has failed and none are left, raise."""
        with self._changed:
            self._changed.wait_for(lambda: self._pending or self._error, max(0.0, timeout_s))
            if self._error and not self._pending:
                raise OSError(self._error, "reading the port failed")
            return bool(self._pending)

    def _take(self, size: int) -> bytes:
        with self._changed:
            data = bytes(self._pending[:size])
            del self._pending[:size]
            self._changed.notify_all()
        return data

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that the thread has read; wait at most `timeout_s` (s) for the first byte."""
        self._ready(timeout_s)
        return self._take(PENDING_BYTES)

    def write(self, data: bytes) -> None:
        """Send all of `data` to the device."""
        while data:
            data = data[self.send(data) :]

    def plugs(self) -> CallbackPlugs:
        """Return the read, write and wait functions by which the compiled loop uses this line."""
        if self._plugs is None:
            self._plugs = callback_plugs(read=self._read_now, write=self.send, wait=self._wait)
        return self._plugs

    def _read_now(self, size: int) -> bytes:
        return self._take(size) if self._ready(0.0) else b""

    def _wait(self, deadline_ns: int) -> bool:
        while True:
            remaining_ns = deadline_ns - time.perf_counter_ns()
            ready = self._ready(remaining_ns * 1e-9)
            if ready or remaining_ns <= 0:
                return ready

    def close(self) -> None:
        """End the reader thread; a second call does nothing."""
        self._closing = True
        with self._changed:
            self._changed.notify_all()
        self._reader.join(CLOSE_S)
