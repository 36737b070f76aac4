"""Convert messages to raw frames and back, with one precompiled struct for each class."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from typing import Annotated, NamedTuple

from firmware_protocol.errors import LocalProtocolError, RemoteProtocolError
from firmware_protocol.framing import CRC_BYTES, HEADER_BYTES, RAW_LIMIT, SHORT_RAW_LIMIT
from firmware_protocol.messages import (
    BATCH_LAYOUTS,
    MAJOR,
    MESSAGES,
    Batch,
    Delivery,
    FaultEntry,
    Message,
    delivery_of,
    sender_of,
)
from firmware_protocol.wire import FORMATS, Wire, field_getter, fixed_fields, record_struct, wire_fields

STUFFING_BYTES = 1  # COBS adds one byte up to 254


class Header(NamedTuple):
    """Header of every frame, before the payload."""

    major: Annotated[int, Wire("u8", "", "major protocol version of the sender")]
    type_id: Annotated[int, Wire("u8", "", "type of the message, see below")]
    flags: Annotated[int, Wire("u8", "", "reserved: sent as 0, ignored on receipt")]
    session: Annotated[
        int, Wire("u8", "", "session of the armed run; 0 when not armed; in ARM the new session")
    ]
    sequence: Annotated[
        int, Wire("u16", "", "counts the frames of this type; from 0 in each session for streams")
    ]


HEADER = record_struct(Header)


class Layout:
    """Layout of a message class in a frame, built once from its annotations."""

    def __init__(self, type_id: int, cls: type[Message]) -> None:
        self.type_id = type_id
        self.cls: Callable[..., Message] = cls
        self.name = cls.__name__
        self.sender = sender_of(type_id)
        self.delivery = delivery_of(type_id)
        self.tail = len(fixed_fields(cls)) < len(wire_fields(cls))
        self.struct = record_struct(cls)
        self.size = self.struct.size
        self.limit = (
            (RAW_LIMIT if self.delivery is Delivery.BATCH else SHORT_RAW_LIMIT) - CRC_BYTES - HEADER_BYTES
        )
        self._get = field_getter(cls)

    @property
    def data_limit(self) -> int:
        """Return the largest number of bytes of the field `data`; 0 for a message without that field."""
        return self.limit - self.size if self.tail else 0

    def pack(self, message: Message) -> bytes:
        """Return the payload of a message; raise `LocalProtocolError` for a value that its C type cannot hold."""
        try:
            payload = self.struct.pack(*self._get(message))
        except struct.error as error:
            raise LocalProtocolError(f"{message!r}: {error}") from None
        if self.tail:
            payload += message.data  # type: ignore[attr-defined]
            if len(payload) > self.limit:
                raise LocalProtocolError(
                    f"{self.name} with {len(payload) - self.size} bytes of data: at most {self.data_limit} are allowed"
                )
        return payload

    def unpack(self, raw: bytes) -> Message:
        """Return the message in a raw frame; raise `RemoteProtocolError` if the length does not fit the type.

        Bytes after the last known field belong to a newer minor version and are ignored.
        """
        if not self.size <= len(raw) - HEADER_BYTES <= self.limit:
            raise RemoteProtocolError(
                f"{self.name} with a payload of {len(raw) - HEADER_BYTES} bytes: {self.size} … {self.limit} are allowed"
            )
        if self.tail:
            return self.cls(*self.struct.unpack_from(raw, HEADER_BYTES), raw[HEADER_BYTES + self.size :])
        return self.cls(*self.struct.unpack_from(raw, HEADER_BYTES))


LAYOUTS: dict[int, Layout] = {type_id: Layout(type_id, cls) for type_id, cls in MESSAGES.items()}
LAYOUT_OF: dict[type[Message], Layout] = {MESSAGES[type_id]: layout for type_id, layout in LAYOUTS.items()}


def type_id_of(cls: type[Message]) -> int:
    """Return the type id of a message class."""
    return LAYOUT_OF[cls].type_id


def data_limit(cls: type[Message]) -> int:
    """Return the largest number of bytes in the field `data` of a message of this class."""
    return LAYOUT_OF[cls].data_limit


def encoded_bytes(cls: type[Message]) -> int:
    """Return the size (bytes) on the wire of a message of fixed size: header, fields, CRC, stuffing and delimiter."""
    return HEADER_BYTES + LAYOUT_OF[cls].size + CRC_BYTES + STUFFING_BYTES + 1


def pack(message: Message, *, session: int = 0, sequence: int = 0) -> bytes:
    """Return a raw frame (header and payload, without CRC); raise `LocalProtocolError` for values that do not fit."""
    layout = LAYOUT_OF[type(message)]
    try:
        header = HEADER.pack(MAJOR, layout.type_id, 0, session, sequence)
    except struct.error as error:
        raise LocalProtocolError(f"session {session}, sequence {sequence}: {error}") from None
    return header + layout.pack(message)


def unpack(raw: bytes) -> tuple[Header, Message]:
    """Return the header and message of a raw frame.

    Raise `RemoteProtocolError` for an unknown type or a payload of wrong length. The caller must check the major
    version, because IDENTIFY is accepted from every version.
    """
    if len(raw) < HEADER_BYTES:
        raise RemoteProtocolError(
            f"a frame of {len(raw)} bytes is shorter than its header ({HEADER_BYTES} bytes)"
        )
    header = Header._make(HEADER.unpack_from(raw))
    layout = LAYOUTS.get(header.type_id)
    if layout is None:
        raise RemoteProtocolError(f"unknown message type 0x{header.type_id:02X}")
    return header, layout.unpack(raw)


_FAULT_ENTRY = record_struct(FaultEntry)
_fault_values = field_getter(FaultEntry)
FAULT_ENTRY_BYTES = _FAULT_ENTRY.size


def pack_fault_entries(entries: Iterable[FaultEntry]) -> bytes:
    """Return the bytes of consecutive FAULT_ENTRYs; raise `LocalProtocolError` for values that do not fit."""
    try:
        return b"".join(_FAULT_ENTRY.pack(*_fault_values(entry)) for entry in entries)
    except struct.error as error:
        raise LocalProtocolError(f"fault entry: {error}") from None


def unpack_fault_entries(data: bytes) -> list[FaultEntry]:
    """Return the FAULT_ENTRYs of a fault log, oldest first; raise `RemoteProtocolError` for a wrong length."""
    if len(data) % FAULT_ENTRY_BYTES:
        raise RemoteProtocolError(
            f"a fault log of {len(data)} bytes: the length must be a multiple of {FAULT_ENTRY_BYTES}"
        )
    return [FaultEntry(*values) for values in _FAULT_ENTRY.iter_unpack(data)]


_SAMPLES = {
    layout: struct.Struct("<" + "".join(FORMATS[ctype] for ctype in ctypes))
    for layout, ctypes in BATCH_LAYOUTS.items()
}


def pack_batch_samples(layout: int, samples: Iterable[tuple[int, ...]]) -> bytes:
    """Return the bytes of the samples of a BATCH: count difference, commanded and, in some layouts, measured current.

    Raise `LocalProtocolError` for values that do not fit.
    """
    try:
        return b"".join(_SAMPLES[layout].pack(*sample) for sample in samples)
    except struct.error as error:
        raise LocalProtocolError(f"sample of a batch: {error}") from None


def unpack_batch_samples(batch: Batch) -> list[tuple[int, ...]]:
    """Return the samples of a BATCH, oldest first; raise `RemoteProtocolError` for a wrong layout or length."""
    found = _SAMPLES.get(batch.layout)
    if found is None:
        raise RemoteProtocolError(
            f"unknown layout {batch.layout} of a BATCH: layouts are 0 … {max(_SAMPLES)}"
        )
    if not batch.data or len(batch.data) % found.size:
        raise RemoteProtocolError(
            f"a BATCH with {len(batch.data)} bytes of samples: layout {batch.layout} needs a multiple of {found.size}"
        )
    return list(found.iter_unpack(batch.data))
