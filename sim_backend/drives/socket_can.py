"""Convert CAN frames to and from the messages of a raw CAN socket of Linux: 16 bytes (classic CAN) or 72 (CAN FD).

Layout: ``struct canfd_frame`` of include/uapi/linux/can.h. Outlets and adapters use it. It must not know a protocol
above CAN.
"""

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
_LENGTHS: tuple[int, ...] = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # lengths of data that CAN FD allows


def pad(data: bytes, padding: int = 0) -> bytes:
    """Return `data`, extended with the byte `padding` to the next length that a CAN FD frame allows."""
    size = next(size for size in _LENGTHS if size >= len(data))
    return data + bytes((padding,)) * (size - len(data))


def from_wire(message: bytes) -> bytes:
    """Return a CAN socket's message, a frame of 16 or 72 bytes, extended to 72 bytes; b"" for any other message."""
    # Inside the simulation every frame has 72 bytes, and a flag gives its format: a byte stream without message
    # boundaries could not be split otherwise.
    if len(message) == CLASSIC_BYTES:
        return message[:5] + bytes(3) + message[8:] + bytes(FD_DATA_BYTES - CLASSIC_DATA_BYTES)
    if len(message) == FD_BYTES:
        return message[:5] + bytes((message[5] | FD_FORMAT,)) + message[6:]
    return b""


def to_wire(unit: bytes) -> bytes:
    """Return the message of a CAN socket for a frame of 72 bytes: 16 bytes for classic CAN, 72 for CAN FD."""
    return unit if unit[5] & FD_FORMAT else unit[:CLASSIC_BYTES]


class Frames:
    """A splitter of bytes into frames of 72 bytes, one for each CAN frame."""

    def split(self, data: bytes) -> list[bytes]:
        """Return the frames of 72 bytes in `data`, which must contain only complete frames."""
        return [data[at : at + FD_BYTES] for at in range(0, len(data), FD_BYTES)]


class SocketCan:
    """A converter between units of 72 bytes and CAN frames, as a `sim_backend.drives.bus.SimulatedAdapter`.

    Parameters
    ----------
    fd
        True for a drive with CAN FD and its faster bit rate; False for one that accepts only classic CAN.
    padding
        Byte that fills up data to a length that CAN FD allows.
    """

    def __init__(self, *, fd: bool = False, padding: int = 0) -> None:
        self._fd = fd
        self._padding = padding

    def splitter(self) -> Frames:
        """Return a new splitter for the bytes that the host sends."""
        return Frames()

    def open(self, unit: bytes) -> tuple[Frame | None, list[bytes]]:
        """Return the CAN frame in the 72 bytes of `unit`, and no reply.

        The frame is None for an error frame, and for a CAN FD frame if the drive accepts only classic CAN.
        """
        if len(unit) != FD_BYTES:
            return None, []
        word, size, flags, data = _FRAME.unpack(unit)
        if word & ERROR or (flags & FD_FORMAT and not self._fd):
            return None, []
        remote = bool(word & REMOTE)
        data = b"" if remote else data[:size]
        return Frame(word & _ID, data, extended=bool(word & EXTENDED), remote=remote), []

    def close(self, frame: Frame) -> list[bytes]:
        """Return a list with the 72 bytes that carry a CAN frame (also an error frame) to the host."""
        word = frame.identifier
        for flag, holds in ((EXTENDED, frame.extended), (REMOTE, frame.remote), (ERROR, frame.error)):
            word |= flag if holds else 0
        if self._fd and not frame.error:
            word |= EXTENDED if frame.identifier > STANDARD_IDS else 0
            data = pad(frame.data, self._padding)
            return [_FRAME.pack(word, len(data), FD_FORMAT | BIT_RATE_SWITCH, data)]
        return [_FRAME.pack(word, len(frame.data), 0, frame.data)]
