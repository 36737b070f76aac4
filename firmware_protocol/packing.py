"""Convert messages to raw frames (header and payload) and back, with one precompiled struct for each message class.

`Connection`, the code generator and `rig.devices.framed` use it. It must not check states: `Connection` does.
"""

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
    """Header of a frame; every frame begins with these fields."""

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
    """Positions and C types of a message's fields in a frame, derived once from the message class's annotations."""

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
        """Return the largest length of the field `data` (bytes); 0 for a message without that field."""
        return self.limit - self.size if self.tail else 0

    def pack(self, message: Message) -> bytes:
        """Return the payload bytes of a message; raise `LocalProtocolError` for a value that its C type cannot hold."""
        try:
            payload = self.struct.pack(*self._get(message))
        except struct.error as error:
            raise LocalProtocolError(f"a field of {message!r} does not fit its C type: {error}") from None
        if self.tail:
            payload += message.data  # type: ignore[attr-defined]
            if len(payload) > self.limit:
                raise LocalProtocolError(
                    f"{len(payload) - self.size} bytes of data in {self.name}: a frame has room for {self.data_limit}"
                )
        return payload

    def unpack(self, raw: bytes) -> Message:
        """Return the message in a raw frame; raise `RemoteProtocolError` if the frame's length does not fit its type.

        Bytes after the last known field belong to a newer minor version and are ignored.
        """
        if not self.size <= len(raw) - HEADER_BYTES <= self.limit:
            raise RemoteProtocolError(
                f"payload of {self.name} has {len(raw) - HEADER_BYTES} bytes; expected {self.size} … {self.limit}"
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
    """Return the largest length (bytes) of the field `data` in a message of class `cls`."""
    return LAYOUT_OF[cls].data_limit


def encoded_bytes(cls: type[Message]) -> int:
    """Return the length (bytes) on the link of a message of fixed size, from its header to the delimiter."""
    return HEADER_BYTES + LAYOUT_OF[cls].size + CRC_BYTES + STUFFING_BYTES + 1


def pack(message: Message, *, session: int = 0, sequence: int = 0) -> bytes:
    """Return the raw frame of a message, without CRC; raise `LocalProtocolError` if a value does not fit its field."""
    layout = LAYOUT_OF[type(message)]
    try:
        header = HEADER.pack(MAJOR, layout.type_id, 0, session, sequence)
    except struct.error as error:
        raise LocalProtocolError(
            f"session {session} or sequence {sequence} does not fit the header: {error}"
        ) from None
    return header + layout.pack(message)


def unpack(raw: bytes) -> tuple[Header, Message]:
    """Return the header and the message of a raw frame (header and payload, without CRC).

    Raise `RemoteProtocolError` for an unknown message type or a payload of wrong length. The caller must check the
    major version, because a device accepts IDENTIFY from every version.
    """
    if len(raw) < HEADER_BYTES:
        raise RemoteProtocolError(
            f"a frame of {len(raw)} bytes is too short: its header alone has {HEADER_BYTES} bytes"
        )
    header = Header._make(HEADER.unpack_from(raw))
    layout = LAYOUTS.get(header.type_id)
    if layout is None:
        raise RemoteProtocolError(f"unknown message type 0x{header.type_id:02X}; PROTOCOL.md lists all types")
    return header, layout.unpack(raw)


_FAULT_ENTRY = record_struct(FaultEntry)
_fault_values = field_getter(FaultEntry)
FAULT_ENTRY_BYTES = _FAULT_ENTRY.size


def pack_fault_entries(entries: Iterable[FaultEntry]) -> bytes:
    """Return the fault log's entries as bytes; raise `LocalProtocolError` for a value that does not fit its field."""
    try:
        return b"".join(_FAULT_ENTRY.pack(*_fault_values(entry)) for entry in entries)
    except struct.error as error:
        raise LocalProtocolError(f"a value of a fault log entry does not fit its field: {error}") from None


def unpack_fault_entries(data: bytes) -> list[FaultEntry]:
    """Return the entries of a fault log, oldest first; raise `RemoteProtocolError` for a wrong length."""
    if len(data) % FAULT_ENTRY_BYTES:
        raise RemoteProtocolError(
            f"the fault log has {len(data)} bytes; expected a multiple of {FAULT_ENTRY_BYTES}, the size of an entry"
        )
    return [FaultEntry(*values) for values in _FAULT_ENTRY.iter_unpack(data)]


_SAMPLES = {
    layout: struct.Struct("<" + "".join(FORMATS[ctype] for ctype in ctypes))
    for layout, ctypes in BATCH_LAYOUTS.items()
}


def pack_batch_samples(layout: int, samples: Iterable[tuple[int, ...]]) -> bytes:
    """Return samples (count difference, commanded current, measured current) as bytes of a BATCH; currents in quanta.

    Layout 1 has no measured current. Raise `LocalProtocolError` for a value that does not fit its C type.
    """
    try:
        return b"".join(_SAMPLES[layout].pack(*sample) for sample in samples)
    except struct.error as error:
        raise LocalProtocolError(f"a sample does not fit layout {layout} of a BATCH: {error}") from None


def unpack_batch_samples(batch: Batch) -> list[tuple[int, ...]]:
    """Return the samples of a BATCH, oldest first: (count difference, commanded current, measured current) in quanta.

    Layout 1 has no measured current. Raise `RemoteProtocolError` for an unknown layout or a wrong length.
    """
    found = _SAMPLES.get(batch.layout)
    if found is None:
        raise RemoteProtocolError(
            f"a BATCH has the unknown sample layout {batch.layout}; known layouts are 0 … {max(_SAMPLES)}"
        )
    if not batch.data or len(batch.data) % found.size:
        raise RemoteProtocolError(
            f"a BATCH has {len(batch.data)} bytes of samples; layout {batch.layout} needs a multiple of {found.size}"
        )
    return list(found.iter_unpack(batch.data))
