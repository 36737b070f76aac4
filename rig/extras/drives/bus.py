"""Exchange CAN frames with a drive before its firmware (a bridge) runs, by a serial adapter or Linux's CAN interface.

The bridge's own C code converts between bytes and frames.
"""

import ctypes
import os
import select
import socket
import sys
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self

from rig.core.errors import ConfigError, DeviceNotFoundError, LinkLostError
from rig.devices.device import DeviceUrl
from rig.extras.drives.library import Adapter, CanFrameBytes, library

if sys.platform == "linux":
    from rig.devices.serial import SerialLink
    from rig.devices.serial import open_link as open_serial

assert sys.platform == "linux"

# Which take no checksum until they have been sent one (mjbots/moteus, lib/python/moteus/fdcanusb_device.py).
WITHOUT_CHECKSUM = ("0483:5740", "1209:2323")
OPTIONS = ("baud", "checksum")
READ_BYTES = 4096
CLASSIC = "bitrate 1000000"
FD = "bitrate 1000000 dbitrate 5000000 sample-point 0.666 dsample-point 0.666 fd on"
_CAN_RAW_ERR_FILTER = 2  # linux/can/raw.h
_FRAME_KIND = 1  # SOCKETCAN_FRAME of socketcan.h


@dataclass(frozen=True, slots=True)
class CanFrame:
    """A CAN frame with up to 64 bytes; a `classic` frame has at most 8, a `remote` frame requests such a frame."""

    id: int
    data: bytes
    classic: bool = False
    remote: bool = False

    def as_struct(self) -> CanFrameBytes:
        """Convert the frame to the struct of the C code."""
        return CanFrameBytes(
            self.id, len(self.data), (ctypes.c_uint8 * 64)(*self.data), self.classic, self.remote
        )


class Bus(Protocol):
    """Interface (`typing.Protocol`) of a bus, by which Python finds the drive.

    Afterwards the bridge (firmware on this computer in front of the drive) uses the bus by its file descriptor.

    Attributes
    ----------
    place
        Name of the bus in URLs and messages.
    descriptor
        File descriptor of the open port or socket, in non-blocking mode.
    checksum, is_socket
        True if frames contain a checksum, and if the descriptor is a socket: settings of a bridge.
    messages
        Settings that could not be applied, one sentence each with its remedy.
    """

    place: str
    descriptor: int
    checksum: bool
    is_socket: bool
    messages: tuple[str, ...]

    def send(self, frame: CanFrame) -> None:
        """Send a frame; raise `LinkLostError` if the bus has failed."""
        ...

    def receive(self, timeout_s: float) -> CanFrame | None:
        """Return the next frame from any sender, or None after the timeout; raise `LinkLostError` if the bus failed."""
        ...

    def close(self) -> None:
        """Close the port or interface of the bus."""
        ...


def open_bus(url: DeviceUrl) -> Bus:
    """Open the bus of a URL: ``moteus:///dev/fdcanusb?checksum=off``, ``odrive://can0``, or a Unix socket for tests.

    Raise `ConfigError` if the URL names no bus or an option is not valid, `DeviceNotFoundError` if the port or
    interface does not exist or another program uses it.
    """
    classic = url.scheme == "odrive"
    if not url.place or (classic and "/" in url.place and not Path(url.place).is_socket()):
        either = "" if classic else f"{url.scheme}:///dev/fdcanusb or "
        raise ConfigError(
            f"{url.text}: the URL names no {'' if classic else 'serial port and no '}CAN interface",
            remedy=f"name one, for example {either}{url.scheme}://can0",
        )
    if Path(url.place).is_socket():
        return CanBus(url.place, _connect(url.place))
    return (
        AdapterBus.open(url) if "/" in url.place else CanBus(url.place, bit_rates=CLASSIC if classic else FD)
    )


def _connect(place: str) -> socket.socket:
    """Return a connected Unix socket with the messages of a raw CAN socket, for a program that simulates a bus."""
    end = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        end.connect(place)
    except OSError as error:
        end.close()
        raise DeviceNotFoundError(
            f"no program accepts connections at the socket {place}: {error.strerror}",
            remedy="start the program, or correct the path of its socket in the URL",
        ) from None
    return end


class AdapterBus:
    """A CAN bus behind a serial adapter: fdcanusb, mjcanfd-usb-1x, or an adapter with the same protocol."""

    is_socket = False

    def __init__(self, link: SerialLink, *, checksum: bool) -> None:
        self.place = link.url.place
        self.descriptor = int(link.port().handle)
        self.checksum = checksum
        self.messages = tuple(link.messages)
        self._link = link
        self._library = library()
        self._adapter = Adapter(checksum=checksum)
        self._waiting: deque[CanFrame] = deque()

    @classmethod
    def open(cls, url: DeviceUrl) -> Self:
        """Open the serial port that a URL names."""
        baud = {name: text for name, text in url.options.items() if name == "baud"}
        link = open_serial(DeviceUrl("serial", url.place, baud, url.text))
        wanted = url.choice(
            "checksum", ("on", "off"), "off" if link.facts.vid_pid in WITHOUT_CHECKSUM else "on"
        )
        return cls(link, checksum=wanted == "on")

    @property
    def refused(self) -> int:
        """Number of text lines, each of them a frame to send, that the adapter refused."""
        return int(self._adapter.refused)

    def send(self, frame: CanFrame) -> None:
        """Send one CAN frame through the adapter; raise `LinkLostError` if the port has failed."""
        line = ctypes.create_string_buffer(256)
        count = self._library.fdcanusb_make(ctypes.byref(self._adapter), frame.as_struct(), line)
        self._link.write(line.raw[:count])

    def receive(self, timeout_s: float) -> CanFrame | None:
        """Return the next CAN frame from the adapter, or None after the timeout."""
        deadline = time.monotonic() + timeout_s
        frame = CanFrameBytes()
        while not self._waiting and (left := deadline - time.monotonic()) > 0:
            for byte in self._link.read(left):
                if self._library.fdcanusb_take(ctypes.byref(self._adapter), byte, ctypes.byref(frame)):
                    self._waiting.append(CanFrame(frame.id, frame.data))
        return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        """Close the serial port."""
        self._link.close()


class CanBus:
    """A CAN interface of Linux, such as can0, as a raw socket."""

    checksum = False
    is_socket = True
    messages: tuple[str, ...] = ()

    def __init__(self, place: str, end: socket.socket | None = None, *, bit_rates: str = FD) -> None:
        self.place = place
        self._socket = end or self._open(place, bit_rates)
        self._socket.setblocking(False)
        self.descriptor = self._socket.fileno()
        self._library = library()

    @staticmethod
    def _open(place: str, bit_rates: str) -> socket.socket:
        try:
            end = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except OSError as error:
            raise DeviceNotFoundError(
                f"this kernel has no raw CAN sockets: {error.strerror}",
                remedy="load the module: sudo modprobe can-raw",
            ) from None
        try:
            end.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            end.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, socket.CAN_ERR_MASK)
            end.bind((place,))
        except OSError as error:
            end.close()
            raise DeviceNotFoundError(
                f"the CAN interface {place} cannot be opened: {error.strerror}",
                remedy=f"name one that `ip link show type can` lists, and bring it up: sudo ip link set {place} up "
                f"type can {bit_rates}",
            ) from None
        return end

    def send(self, frame: CanFrame) -> None:
        """Send one CAN frame; raise `LinkLostError` if the interface has failed."""
        packed = ctypes.create_string_buffer(72)
        count = self._library.socketcan_make(frame.as_struct(), packed)
        try:
            self._socket.send(packed.raw[:count])
        except OSError as error:
            raise self._interface_failed_error(error) from None

    def receive(self, timeout_s: float) -> CanFrame | None:
        """Return the next CAN frame, or None after the timeout; raise `LinkLostError` if the interface failed."""
        deadline = time.monotonic() + timeout_s
        frame = CanFrameBytes()
        while (left := deadline - time.monotonic()) > 0:
            if not select.select([self._socket], [], [], left)[0]:
                return None
            try:
                data = os.read(self.descriptor, READ_BYTES)
            except OSError as error:
                raise self._interface_failed_error(error) from None
            if self._library.socketcan_take(data, len(data), ctypes.byref(frame)) == _FRAME_KIND:
                return CanFrame(frame.id, frame.data)
        return None

    def close(self) -> None:
        """Close the socket of the interface."""
        self._socket.close()

    def _interface_failed_error(self, error: OSError) -> LinkLostError:
        return LinkLostError(
            f"the CAN interface {self.place} has failed: {error.strerror}",
            remedy=f"check its state with `ip -details link show {self.place}`: it must be up and not bus-off",
        )
