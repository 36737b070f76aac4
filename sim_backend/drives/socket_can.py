"""Convert CAN frames as Linux has them on a raw socket: one a message, of 16 bytes (classic) or 72 (CAN FD).

Layout: ``struct canfd_frame`` of include/uapi/linux/can.h.
"""

from __future__ import annotations

import struct

from sim_backend.drives.bus import Frame

CLASSIC_BYTES, FD_BYTES = 16, 72
FD_DATA_BYTES, CLASSIC_DATA_BYTES = 64, 8
BIT_RATE_SWITCH, FD_FORMAT = 0x01, 0x04  # flags of struct canfd_frame
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000
STANDARD_IDS = 0x7FF
BUS_OFF = 0x40  # class of an error frame: include/uapi/linux/can/error.h
_ID = 0x1FFFFFFF
_FRAME = struct.Struct("=IBB2x64s")
_LENGTHS: tuple[int, ...] = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # of the data of CAN FD


def pad(data: bytes, padding: int = 0) -> bytes:
    """Return the data up to the next length that CAN FD has."""
    size = next(size for size in _LENGTHS if size >= len(data))
    return data + bytes((padding,)) * (size - len(data))


def from_wire(message: bytes) -> bytes:
    """Return a message of a socket as a unit; nothing for what is no frame."""
    # Inside the simulation every frame has 72 bytes, and a flag gives its format: a byte stream without message
    # boundaries could not be split otherwise.
    if len(message) == CLASSIC_BYTES:
        return message[:5] + bytes(3) + message[8:] + bytes(FD_DATA_BYTES - CLASSIC_DATA_BYTES)
    if len(message) == FD_BYTES:
        return message[:5] + bytes((message[5] | FD_FORMAT,)) + message[6:]
    return b""


def to_wire(unit: bytes) -> bytes:
    """Return the message that carries a unit."""
    return unit if unit[5] & FD_FORMAT else unit[:CLASSIC_BYTES]


class Frames:
    """Cuts bytes into units."""

    def split(self, data: bytes) -> list[bytes]:
        """Return whole units; a bus passes no others."""
        return [data[at : at + FD_BYTES] for at in range(0, len(data), FD_BYTES)]


class SocketCan:
    """Frames of a socket; see `sim_backend.drives.bus.SimulatedAdapter`.

    Parameters
    ----------
    fd
        Whether the drive uses CAN FD, with the faster bit rate, or classic CAN, where it receives nothing else.
    padding
        What fills its data up to a length that CAN FD has.
    """

    def __init__(self, *, fd: bool = False, padding: int = 0) -> None:
        self._fd = fd
        self._padding = padding

    def splitter(self) -> Frames:
        """Make what cuts bytes into units."""
        return Frames()

    def open(self, unit: bytes) -> tuple[Frame | None, list[bytes]]:
        """Read a frame; a controller's error frames are ignored."""
        if len(unit) != FD_BYTES:
            return None, []
        word, size, flags, data = _FRAME.unpack(unit)
        if word & ERROR or (flags & FD_FORMAT and not self._fd):
            return None, []
        remote = bool(word & REMOTE)
        data = b"" if remote else data[:size]
        return Frame(word & _ID, data, extended=bool(word & EXTENDED), remote=remote), []

    def close(self, frame: Frame) -> list[bytes]:
        """Return the messages that carry a frame, including an error frame."""
        word = frame.identifier
        for flag, holds in ((EXTENDED, frame.extended), (REMOTE, frame.remote), (ERROR, frame.error)):
            word |= flag if holds else 0
        if self._fd and not frame.error:
            word |= EXTENDED if frame.identifier > STANDARD_IDS else 0
            data = pad(frame.data, self._padding)
            return [_FRAME.pack(word, len(data), FD_FORMAT | BIT_RATE_SWITCH, data)]
        return [_FRAME.pack(word, len(frame.data), 0, frame.data)]
