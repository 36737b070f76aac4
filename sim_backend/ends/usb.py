"""Simulate the rig as a USB device: descriptors, and two bulk endpoints behind a socket.

The program that emulates the bus (an emulated usbfs, a USB/IP server) forwards control requests to `UsbShape.control`
and moves packets through a SOCK_SEQPACKET socket, one message for each packet. Frames are not aligned to packets: the
endpoints carry a byte stream. Tests of the USB link use it.
"""

import contextlib
import select
import socket
import struct
import threading
import time
from dataclasses import dataclass

from firmware_protocol.messages import USB_PRODUCT, USB_VENDOR
from rig.core.errors import ConfigError
from rig.core.model import RigModel
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.real_time import RealTime, sleep_until

VENDOR_CLASS = 0xFF
ENDPOINT_IN, ENDPOINT_OUT = 0x81, 0x01
FULL_SPEED_PACKET, HIGH_SPEED_PACKET = 64, 512
POSITION_RATE_MINIMUM, POSITION_RATE_DEFAULT = 50, 1_000  # Hz
POSITION_RATE_MAXIMUM = 4_000  # Hz; faster, Python is too late
PENDING_BYTES = 8192  # unread output of the device
SOCKET_BYTES = 2304  # doubled by the kernel to its least: a handful of packets, as a device would hold

_DEVICE, _CONFIGURATION, _STRING, _INTERFACE, _ENDPOINT = 1, 2, 3, 4, 5
_ENGLISH = 0x0409
_BULK = 2
_GET_STATUS, _CLEAR_FEATURE, _SET_FEATURE, _SET_ADDRESS, _GET_DESCRIPTOR = 0, 1, 3, 5, 6
_GET_CONFIGURATION, _SET_CONFIGURATION, _GET_INTERFACE, _SET_INTERFACE = 8, 9, 10, 11
_TO_HOST = 0x80  # bit of bmRequestType
_SETUP = struct.Struct("<BBHHH")


@dataclass(frozen=True, slots=True)
class UsbShape:
    """The USB descriptors of the simulated device, and its replies to standard control requests."""

    vendor: int = USB_VENDOR
    product: int = USB_PRODUCT
    serial: str = "0001"
    maker: str = "haptic-rig"
    name: str = "simulated rig"
    packet: int = FULL_SPEED_PACKET  # bytes; 64 at full speed, 512 at high speed
    interface_class: int = VENDOR_CLASS

    def device(self) -> bytes:
        """Return the USB device descriptor (18 bytes)."""
        # USB 2.0; class given by the interface; 64 bytes at endpoint 0; device 1.0; strings 1 to 3; one configuration.
        return struct.pack(
            "<BBHBBBBHHHBBBB",
            *(18, _DEVICE, 0x0200, 0, 0, 0, 64, self.vendor, self.product, 0x0100, 1, 2, 3, 1),
        )

    def configuration(self) -> bytes:
        """Return the USB configuration descriptor with the interface and its two endpoints."""
        interface = struct.pack("<9B", 9, _INTERFACE, 0, 0, 2, self.interface_class, 0, 0, 4)
        endpoints = b"".join(
            struct.pack("<BBBBHB", 7, _ENDPOINT, address, _BULK, self.packet, 0)
            for address in (ENDPOINT_IN, ENDPOINT_OUT)
        )
        total = 9 + len(interface) + len(endpoints)
        bus_powered, current_2ma = 0x80, 50
        head = struct.pack("<BBHBBBBB", 9, _CONFIGURATION, total, 1, 1, 0, bus_powered, current_2ma)
        return head + interface + endpoints

    def string(self, index: int) -> bytes | None:
        """Return string descriptor `index` (0 languages, 1 maker, 2 name, 3 serial number, 4 interface), else None."""
        texts = (self.maker, self.name, self.serial, "haptic rig bytes")
        if index == 0:
            content = struct.pack("<H", _ENGLISH)
        elif 1 <= index <= len(texts):
            content = texts[index - 1].encode("utf-16-le")
        else:
            return None
        return struct.pack("<BB", 2 + len(content), _STRING) + content

    def control(self, setup: bytes) -> bytes | None:
        """Return the reply to a standard control request from the eight bytes of its SETUP packet.

        The reply is the data stage, which may be empty; None to stall, for a request that this device does not support.
        """
        direction, request, value, _, length = _SETUP.unpack(setup)
        if request == _GET_DESCRIPTOR:
            kind, index = value >> 8, value & 0xFF
            if kind == _STRING:
                found = self.string(index)
            else:
                found = {_DEVICE: self.device(), _CONFIGURATION: self.configuration()}.get(kind)
            return None if found is None else found[:length]
        if request == _GET_STATUS:
            return b"\0\0"[:length]
        if request in (_GET_CONFIGURATION, _GET_INTERFACE) and direction & _TO_HOST:
            return bytes([1 if request == _GET_CONFIGURATION else 0])[:length]
        silent = (_CLEAR_FEATURE, _SET_FEATURE, _SET_ADDRESS, _SET_CONFIGURATION, _SET_INTERFACE)
        return b"" if request in silent else None


class UsbPort:
    """The device's side of the two bulk endpoints: read and write bytes (the interface `real_time.DevicePort`).

    `end` is a connected SOCK_SEQPACKET socket, `packet` the largest packet (bytes).
    """

    def __init__(self, end: socket.socket, packet: int = FULL_SPEED_PACKET) -> None:
        end.setblocking(False)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BYTES)
        self._end = end
        self._packet = packet
        self._pending = b""
        self.unplugged = False

    def read(self, deadline_ns: int) -> bytes:
        """Return the next packet from the host; wait until the deadline (CLOCK_MONOTONIC, ns), then return b""."""
        if self.unplugged:
            sleep_until(deadline_ns)
            return b""
        remaining_s = max(0, deadline_ns - time.monotonic_ns()) * 1e-9
        readable, _, _ = select.select([self._end], [], [], remaining_s)
        if not readable:
            return b""
        try:
            data = self._end.recv(HIGH_SPEED_PACKET * 32)
        except BlockingIOError:
            return b""
        except OSError:
            # As an end of file: the host is gone either way.
            data = b""
        self.unplugged = not data
        return data

    def write(self, frames: bytes) -> None:
        """Send frames now, or when the host reads; discard them if more than 8 KiB (`PENDING_BYTES`) are unread."""
        # As on the wire, packets that the host does not fetch stay with the device: it keeps the frames that it
        # holds, and discards each new one whole.
        if self.unplugged or len(self._pending) + len(frames) > PENDING_BYTES:
            return
        self._pending += frames
        with contextlib.suppress(OSError):
            while self._pending:
                sent = self._end.send(self._pending[: self._packet])
                self._pending = self._pending[sent:]

    def write_if_free(self, frame: bytes) -> None:
        """Send a frame unless older ones still wait; the host sees the loss from the sequence numbers."""
        if self._pending:
            self.write(b"")
        if not self._pending:
            self.write(frame)


def serve(
    model: RigModel,
    end: socket.socket,
    *,
    rate: int = POSITION_RATE_DEFAULT,
    packet: int = FULL_SPEED_PACKET,
    seed: int = 0,
    stop_event: threading.Event | None = None,
    duration_s: float | None = None,
) -> None:
    """Run a simulated rig behind the bulk endpoints until it is stopped.

    Raise `ConfigError` if the rate is outside 50 Hz to `POSITION_RATE_MAXIMUM` (Hz), which a process in Python can
    keep.

    Parameters
    ----------
    model
        Rig to simulate.
    end
        Device side of the endpoints: a connected socket that keeps message boundaries. The caller must close it.
    rate
        Tick rate of the device until the host configures one (Hz).
    packet
        Largest packet (bytes).
    seed
        Seed of the sensor noise.
    stop_event
        Ends the run when it is set.
    duration_s
        Ends the run after this time (s).
    """
    if not POSITION_RATE_MINIMUM <= rate <= POSITION_RATE_MAXIMUM:
        raise ConfigError(
            f"rate = {rate} Hz is outside {POSITION_RATE_MINIMUM} … {POSITION_RATE_MAXIMUM} Hz",
            remedy="use a rate in this range; higher rates run in virtual time only (sim://)",
        )
    device = SimulatedDevice(
        model,
        position_rate_default=rate,
        position_rate_maximum=POSITION_RATE_MAXIMUM,
        seed=seed,
        keep_truth=False,  # the record would grow without bound, and no caller could read it
    )
    RealTime(device, UsbPort(end, packet), stop_event or threading.Event()).run(duration_s)
