"""Parse and build the register protocol of a moteus: sub-frames in a CAN frame (docs/protocol/can.md of mjbots/moteus).

Sub-frames before the first unreadable one are used, the rest of the frame is ignored. The tunnelled stream (0x40 to
0x42) and its errors are those of mjlib/multiplex/format.h. The form with packet numbers (0x43, 0x44), which the maker's
library tries first, is taken from that library (1.1.1, `moteus/multiplex.py`). `moteus` uses it. It must not know the
meaning of a register.
"""

import math
import struct
from collections.abc import Iterator
from typing import NamedTuple

INT8, INT16, INT32, FLOAT = range(4)
WRITE, READ, REPLY = 0x00, 0x10, 0x20
WRITE_ERROR, READ_ERROR = 0x30, 0x31
CLIENT_TO_SERVER, SERVER_TO_CLIENT, POLL, NUMBERED_REPLY, NUMBERED_POLL = range(0x40, 0x45)
NOP = 0x50

UNKNOWN_REGISTER, NOT_WRITEABLE = 1, 2  # mjlib/multiplex/micro_server.cc
_FORMS = (("b", 1), ("h", 2), ("i", 4), ("f", 4))
_NO_NUMBER = {INT8: -(1 << 7), INT16: -(1 << 15), INT32: -(1 << 31)}  # docs/protocol/registers.md: as NaN


class WriteRegisters(NamedTuple):
    """Sub-frame: write consecutive registers from `first` on; `raws` are the numbers of type `kind` in the frame."""

    first: int
    kind: int
    raws: tuple[float, ...]


class ReadRegisters(NamedTuple):
    """Sub-frame: read `number` consecutive registers from `first` on, as numbers of type `kind`."""

    first: int
    number: int
    kind: int


class StreamData(NamedTuple):
    """Sub-frame: bytes from the host for a channel of the tunnelled stream, such as the console."""

    channel: int
    data: bytes


class StreamPoll(NamedTuple):
    """Sub-frame: request for at most `most` bytes of a channel of the tunnelled stream.

    `acknowledged` is the number of the last packet that the host received; None in the form without packet numbers.
    """

    channel: int
    most: int
    acknowledged: int | None


Subframe = WriteRegisters | ReadRegisters | StreamData | StreamPoll


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self._place = 0

    @property
    def left(self) -> int:
        return len(self._data) - self._place

    def varuint(self) -> int:
        value = shift = 0
        while True:
            byte = self._data[self._place]
            self._place += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    def numbers(self, kind: int, count: int) -> tuple[float, ...]:
        """Return the next `count` numbers of type `kind`; fewer if the frame ends before."""
        letter, size = _FORMS[kind]
        count = min(count, self.left // size)
        values = struct.unpack_from(f"<{count}{letter}", self._data, self._place)
        self._place += count * size
        return values

    def bytes(self, size: int) -> bytes:
        if size > self.left:
            raise IndexError
        self._place += size
        return self._data[self._place - size : self._place]


def subframes(data: bytes) -> Iterator[Subframe]:
    """Yield the sub-frames in the data of a CAN frame, up to the first that is invalid."""
    reader = _Reader(data)
    try:
        while reader.left:
            head = reader.varuint()
            if head < REPLY:
                yield _registers(reader, head)
            elif head == CLIENT_TO_SERVER:
                channel, size = reader.varuint(), reader.varuint()
                yield StreamData(channel, reader.bytes(size))
            elif head == POLL:
                yield StreamPoll(reader.varuint(), reader.varuint(), None)
            elif head == NUMBERED_POLL:
                channel, seen = reader.varuint(), reader.bytes(1)[0]
                yield StreamPoll(channel, reader.varuint(), seen)
            elif head != NOP:
                return
    except IndexError:
        return


def _registers(reader: _Reader, head: int) -> WriteRegisters | ReadRegisters:
    kind = head >> 2 & 3
    count = head & 3 or reader.varuint()
    first = reader.varuint()
    if head >= READ:
        return ReadRegisters(first, count, kind)
    return WriteRegisters(first, kind, reader.numbers(kind, count))


def varuint(value: int) -> bytes:
    """Return a number as bytes of seven bits each, lowest bits first; the top bit is set if more bytes follow."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def reply(first: int, kind: int, values: list[float]) -> bytes:
    """Return the sub-frame with the values of consecutive registers from `first` on, as numbers of type `kind`."""
    count = len(values)
    head = bytes((REPLY | kind << 2 | count,)) if count < 4 else bytes((REPLY | kind << 2,)) + varuint(count)
    return head + varuint(first) + struct.pack(f"<{count}{_FORMS[kind][0]}", *values)


def error(head: int, register: int, number: int) -> bytes:
    """Return the error sub-frame for a register: `head` is `WRITE_ERROR` or `READ_ERROR`, `number` the error number."""
    return bytes((head,)) + varuint(register) + varuint(number)


def scale(raw: float, kind: int, steps: tuple[float, float, float]) -> float:
    """Return the value of a number of type `kind` in a frame; the smallest integer stands for NaN.

    `steps` are the values of one step as int8, int16 and int32.
    """
    if kind == FLOAT:
        return raw
    return math.nan if raw == _NO_NUMBER[kind] else raw * steps[kind]


def unscale(value: float, kind: int, steps: tuple[float, float, float]) -> float:
    """Return a value as a number of type `kind` for a frame, limited to its range; NaN and ∞ give the smallest integer.

    `steps` are the values of one step as int8, int16 and int32.
    """
    if kind == FLOAT:
        return value
    if not math.isfinite(value):
        return _NO_NUMBER[kind]
    most = -_NO_NUMBER[kind] - 1
    # Truncated towards zero, as fw/moteus_controller.cc converts.
    return int(min(max(value / steps[kind], -most), most))
