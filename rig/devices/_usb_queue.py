"""Bulk transfers of an open USB device, prepared for the compiled functions of `rig.devices._usb_transfers`.

`rig.devices.usb` uses it. Python must read and write by the same compiled functions as the loop.
"""

import ctypes
import time
from typing import Any

import numpy as np

from rig.devices import _usb_transfers as compiled
from rig.devices._usb_handle import Handle, Transfer
from rig.devices._usb_transfers import SLOT_WORDS, SLOTS_AT, Slot, Word
from rig.realtime.native import address_of

IN_TRANSFERS = 16  # packets that may arrive while the host is busy elsewhere
OUT_TRANSFERS = 8  # COMMANDs in transit; more than the STOP frames at the end of a run
OUT_BYTES = 512  # buffer of an OUT transfer
OUT_LIMIT_S = 0.5  # longest time in which the device may accept nothing
LAST_WORDS_S = 0.1  # for the last writes to be sent when the link is closed
CANCEL_S = 1.0  # for cancelled transfers to end
_SLICE_S = 0.05  # a compiled wait cannot be interrupted: Ctrl-C is seen in between
_READ_BYTES = 4096  # most that one `read` returns
_BULK = 2  # LIBUSB_TRANSFER_TYPE_BULK


class QueuedTransfers:
    """The two bulk endpoints of a USB interface by queued libusb transfers; a failure raises `OSError` with errno."""

    note = ""

    def __init__(self, handle: Handle, endpoint_in: int, endpoint_out: int, packet: int) -> None:
        self._handle = handle
        count = IN_TRANSFERS + OUT_TRANSFERS
        self._block = np.zeros(SLOTS_AT + SLOT_WORDS * count, np.int64)
        self._incoming = np.zeros((IN_TRANSFERS, packet), np.uint8)
        self._outgoing = np.zeros((OUT_TRANSFERS, OUT_BYTES), np.uint8)
        self._read_buffer = np.zeros(_READ_BYTES, np.uint8)
        self._transfers: list[int] = []
        block = self._block
        for word, value in {
            Word.CONTEXT: handle.context,
            Word.SUBMIT: handle.submit,
            Word.CANCEL: handle.cancel,
            Word.HANDLE_EVENTS: handle.handle_events,
            Word.POLLED: handle.polled.ctypes.data,
            Word.POLLED_COUNT: len(handle.polled),
            Word.IN_COUNT: IN_TRANSFERS,
            Word.OUT_COUNT: OUT_TRANSFERS,
            Word.IN_BYTES: packet,
            Word.OUT_BYTES: OUT_BYTES,
            Word.OUT_LIMIT: round(OUT_LIMIT_S * 1e9),
        }.items():
            block[word] = value
        for index, buffer in enumerate([*self._incoming, *self._outgoing]):
            endpoint = endpoint_in if index < IN_TRANSFERS else endpoint_out
            slot = SLOTS_AT + SLOT_WORDS * index
            block[slot + Slot.TRANSFER] = self._prepare_transfer(
                endpoint, buffer, self._address + 8 * (slot + Slot.STATE)
            )
            block[slot + Slot.BUFFER] = buffer.ctypes.data
        failed = compiled.start(self._address)
        if failed < 0:
            self.close()
            raise OSError(-failed, "the transfers to receive from the USB device cannot be submitted")

    @property
    def _address(self) -> int:
        return int(self._block.ctypes.data)

    def _prepare_transfer(self, endpoint: int, buffer: Any, state_address: int) -> int:
        address = self._handle.make_transfer()
        self._transfers.append(address)
        transfer = Transfer.from_address(address)
        transfer.dev_handle = self._handle.device
        transfer.flags = 0
        transfer.endpoint = endpoint
        transfer.type = _BULK
        transfer.timeout = 0  # none: what waits is bounded here
        transfer.length = len(buffer)
        transfer.callback = address_of(compiled.mark_completed, compiled.COMPLETED_SIGNATURE)
        transfer.user_data = state_address
        transfer.buffer = buffer.ctypes.data
        return address

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that the USB device has sent; wait at most `timeout_s` (s) for the first byte."""
        deadline_ns = time.monotonic_ns() + max(0, round(timeout_s * 1e9))
        ready = 0
        while ready == 0:
            now_ns = time.monotonic_ns()
            ready = compiled.usb_wait(self._address, min(deadline_ns, now_ns + round(_SLICE_S * 1e9)))
            if ready == 0 and now_ns >= deadline_ns:
                return b""
        if ready > 0:
            ready = compiled.usb_read(self._address, self._read_buffer.ctypes.data, _READ_BYTES)
        if ready < 0:
            raise OSError(-ready, "reading from the USB device failed")
        return self._read_buffer[:ready].tobytes()

    def write(self, data: bytes) -> None:
        """Send all of `data`; wait while no transfer is free. `OSError` if the device accepts nothing for 0.5 s."""
        left = np.frombuffer(data, np.uint8)
        while len(left):
            taken = compiled.usb_write(self._address, left.ctypes.data, len(left))
            if taken < 0:
                raise OSError(-taken, "writing to the USB device failed")
            left = left[taken:]
            if taken == 0:
                compiled.flush(self._address, time.monotonic_ns() + round(_SLICE_S * 1e9), 0)

    def plugs(self) -> tuple[Any, Any, Any, int]:
        """Return the read, write and wait functions for the compiled loop, and the address to pass as argument."""
        return compiled.usb_read, compiled.usb_write, compiled.usb_wait, self._address

    def close(self) -> None:
        """Complete the last writes, cancel all other transfers, and free their memory; a second call does nothing."""
        transfers, self._transfers = self._transfers, []
        if not transfers:
            return
        compiled.flush(self._address, time.monotonic_ns() + round(LAST_WORDS_S * 1e9), 0)
        left = compiled.flush(self._address, time.monotonic_ns() + round(CANCEL_S * 1e9), 1)
        # A transfer that the kernel does not return may still be written to: leak the memory rather than free it.
        if left:
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self))
            return
        for address in transfers:
            self._handle.free_transfer(address)
