"""Frames from the tables of the protocol, changed at the level of fields, frames and bytes; most have a valid CRC."""

import random
from collections.abc import Sequence
from typing import Any

from firmware_protocol import messages as m
from firmware_protocol.framing import CRC_BYTES, HEADER_BYTES, RAW_LIMIT, encode_frame
from firmware_protocol.messages import Message
from firmware_protocol.packing import HEADER, LAYOUT_OF, data_limit
from firmware_protocol.wire import wire_fields

_LONGEST = RAW_LIMIT - CRC_BYTES - HEADER_BYTES
_SHARE_OF_NOISE = 0.02
_SHARE_DAMAGED = 0.1  # behind their CRC
_SHARE_RESHAPED = 0.1


def any_value(chance: random.Random, ctype: str) -> int:
    """Return a value of a C integer type, often an end or a small number."""
    signed, bits = ctype[0] == "i", int(ctype[1:])
    kind = chance.random()
    if kind < 0.4:
        return chance.randrange(4)
    if kind < 0.6:
        ends = (
            (0, (1 << bits - 1) - 1, -(1 << bits - 1), -1) if signed else (0, 1 << bits - 1, (1 << bits) - 1)
        )
        return chance.choice(ends)
    value = chance.getrandbits(bits)
    return value - (1 << bits - 1) if signed else value


def any_message(chance: random.Random, classes: Sequence[type[Message]]) -> Message:
    """Return a message of one of the classes, with any value in any field."""
    cls = chance.choice(classes)
    values: dict[str, Any] = {
        name: chance.randbytes(chance.randrange(data_limit(cls) + 1))
        if wire.ctype == "bytes"
        else any_value(chance, wire.ctype)
        for name, wire in wire_fields(cls).items()
    }
    return cls(**values)


def frame_of(message: Message, session: int, sequence: int, major: int = m.MAJOR, flags: int = 0) -> bytes:
    layout = LAYOUT_OF[type(message)]
    return encode_frame(HEADER.pack(major, layout.type_id, flags, session, sequence) + layout.pack(message))


def reshape(chance: random.Random, frame: bytes) -> bytes:
    """Return a frame of this content with another type, length or major version, and a valid CRC."""
    raw = bytearray(_unstuff(frame))
    for _ in range(chance.randrange(1, 3)):
        kind = chance.randrange(5)
        if kind == 0:
            raw[chance.randrange(HEADER_BYTES)] = chance.randrange(256)
        elif kind == 1:
            raw[HEADER_BYTES:] = raw[HEADER_BYTES : HEADER_BYTES + chance.randrange(len(raw))]
        elif kind == 2:
            raw += chance.randbytes(chance.randrange(8))
        elif kind == 3:
            raw += chance.randbytes(chance.randrange(_LONGEST))
        else:
            raw[chance.randrange(len(raw))] ^= 1 << chance.randrange(8)
    return encode_frame(bytes(raw[: _LONGEST + HEADER_BYTES]))


def damage_frame(chance: random.Random, frame: bytes) -> bytes:
    """Return a frame of which some bytes were changed, lost or added in transfer."""
    broken = bytearray(frame)
    for _ in range(chance.randrange(1, 4)):
        at = chance.randrange(len(broken)) if broken else 0
        kind = chance.randrange(4)
        if kind == 0 and broken:
            broken[at] ^= 1 << chance.randrange(8)
        elif kind == 1:
            del broken[at : at + chance.randrange(1, 9)]
        elif kind == 2:
            broken[at:at] = chance.randbytes(chance.randrange(1, 5))
        else:
            broken[at:at] = b"\0"
    return bytes(broken)


def mangled(chance: random.Random, frame: bytes) -> bytes:
    """Return the frame as a faulty line or sender would deliver it; mostly unchanged."""
    kind = chance.random()
    if kind < _SHARE_OF_NOISE:
        return chance.randbytes(chance.randrange(300))
    if kind < _SHARE_DAMAGED:
        return damage_frame(chance, frame)
    if kind < _SHARE_DAMAGED + _SHARE_RESHAPED:
        return reshape(chance, frame)
    return frame * chance.choice((1,) * 15 + (2,))


def _unstuff(frame: bytes) -> bytes:
    """Return header and payload of a frame that `encode_frame` encoded."""
    raw, at = bytearray(frame[:-1]), 0
    while at < len(raw):
        code = raw[at]
        raw[at] = 0
        at += code
    return bytes(raw[1:-CRC_BYTES])
