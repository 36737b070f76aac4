"""Compiled encoder and decoder of the loop's messages, byte for byte equal to `firmware_protocol`.

The messages are COMMAND and STATE; GET_TIME and TIME, which compare the clocks of host and device; BATCH, if the law
runs on the device; and SET_BEGIN, SET_CHUNK, SET_COMMIT and ACK, which change the wall of a law on the device.

All integers are int64. Kernels check received bytes and return a negative number for an error. The caller provides all
arrays; each must have at least the documented length.

`STATE`, `COMMAND`, `GET_TIME` and so on give the index of a field in an array of field values
(``values[STATE.count]``), `HEAD` its index in an array of header values, `SAMPLE` its index in a row of a batch.
Kernels can use these constants.

The loop, the recorder and the round-trip measurement of `rig.doctor` use this file. Its kernels allocate nothing.
"""

from collections import namedtuple
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol import framing, messages
from firmware_protocol.framing import Defect
from firmware_protocol.packing import Header, data_limit, type_id_of
from firmware_protocol.wire import FORMATS, fixed_fields
from rig.realtime.kernel import kernel

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

_bytes = types.uint8[::1]
_ints = types.int64[::1]
_i64 = types.int64
_table = types.Array(types.int64, 2, "C", readonly=True)
_rows = types.int64[:, ::1]

# Negative results. The first four are those of `framing.Defect`.
COBS_ERROR = -int(Defect.COBS)
CRC_ERROR = -int(Defect.CRC)
TOO_LONG = -int(Defect.TOO_LONG)
TOO_SHORT = -int(Defect.TOO_SHORT)
FOREIGN_MAJOR = -5  # header of another major version
OTHER_TYPE = -6  # a good frame, but of another type
BAD_PAYLOAD = -7  # right type, impossible length
BAD_VALUE = -8  # a value that its C type cannot hold

RAW_BYTES = framing.RAW_LIMIT  # room that `decode_frame` may need
FRAME_BYTES = framing.SHORT_RAW_LIMIT + 2  # room that `encode_command` and `encode_state` may need


def field_indices(name: str) -> Any:
    """Return a named tuple with the index of each field of the message class `name` in an array of field values."""
    names = list(fixed_fields(getattr(messages, name)))
    return namedtuple(f"{name}Fields", names)(*range(len(names)))


def _layout(cls: type) -> Ints:
    """Return an array with one row (size in bytes, 1 if signed else 0) for each field of a message, in wire order."""
    rows = []
    for wire in fixed_fields(cls).values():
        size = np.dtype(FORMATS[wire.ctype]).itemsize
        rows.append((size, int(wire.ctype.startswith("i"))))
    return np.array(rows, dtype=np.int64)


# Tables come from the annotations of messages.py at import, so that the bytes are described once.
COMMAND = field_indices("Command")
STATE = field_indices("State")
GET_TIME = field_indices("GetTime")
TIME = field_indices("Time")
BATCH = field_indices("Batch")  # without the samples
SET_BEGIN = field_indices("SetBegin")
SET_CHUNK = field_indices("SetChunk")  # without the data
SET_COMMIT = field_indices("SetCommit")
ACK = field_indices("Ack")
SAMPLE: Any = namedtuple("SampleFields", ("count", "current_commanded", "current_measured"))(*range(3))
HEAD: Any = namedtuple("HeaderFields", Header._fields)(*range(len(Header._fields)))

_HEADER_BYTES = framing.HEADER_BYTES
_CRC_BYTES = framing.CRC_BYTES
_RAW_MINIMUM = framing.RAW_MINIMUM
_ENCODED_LIMIT = framing.ENCODED_LIMIT
_PAYLOAD_LIMIT = framing.SHORT_RAW_LIMIT - _CRC_BYTES - _HEADER_BYTES
_BATCH_LIMIT = framing.RAW_LIMIT - _CRC_BYTES - _HEADER_BYTES
_MAJOR = messages.MAJOR
_COMMAND_TYPE = type_id_of(messages.Command)
_STATE_TYPE = type_id_of(messages.State)
_GET_TIME_TYPE = type_id_of(messages.GetTime)
_TIME_TYPE = type_id_of(messages.Time)
_BATCH_TYPE = type_id_of(messages.Batch)
_ACK_TYPE = type_id_of(messages.Ack)
SET_BEGIN_TYPE = type_id_of(messages.SetBegin)
SET_CHUNK_TYPE = type_id_of(messages.SetChunk)
SET_COMMIT_TYPE = type_id_of(messages.SetCommit)
_COMMAND_LAYOUT = _layout(messages.Command)
_STATE_LAYOUT = _layout(messages.State)
_GET_TIME_LAYOUT = _layout(messages.GetTime)
_TIME_LAYOUT = _layout(messages.Time)
_BATCH_LAYOUT = _layout(messages.Batch)
_ACK_LAYOUT = _layout(messages.Ack)
_SET_BEGIN_LAYOUT = _layout(messages.SetBegin)
_SET_CHUNK_LAYOUT = _layout(messages.SetChunk)
_SET_COMMIT_LAYOUT = _layout(messages.SetCommit)
_BATCH_FIXED = int(_BATCH_LAYOUT[:, 0].sum())
CHUNK_BYTES = data_limit(messages.SetChunk)


def _sample_bytes() -> Ints:
    """Return the size (bytes) of each field of a batch sample; one row per sample layout, 0 for a missing field."""
    rows = np.zeros((len(messages.BATCH_LAYOUTS), len(SAMPLE)), dtype=np.int64)
    for layout, ctypes in messages.BATCH_LAYOUTS.items():
        assert all(ctype.startswith("i") for ctype in ctypes)  # what `_read_signed` reads
        rows[layout, : len(ctypes)] = [np.dtype(FORMATS[ctype]).itemsize for ctype in ctypes]
    return rows


_SAMPLE_BYTES = _sample_bytes()
MOST_SAMPLES = (_BATCH_LIMIT - _BATCH_FIXED) // int(_SAMPLE_BYTES.sum(axis=1).min())
"""Rows that `decode_batch` may fill."""


def _crc_tables(slices: int) -> Ints:
    """Return lookup tables, shape (slices, 256), for CRC-32 with the reflected polynomial 0xEDB88320.

    Row k contains, for each byte value, the CRC of this byte followed by k zero bytes.
    """
    tables = np.zeros((slices, 256), dtype=np.int64)
    for byte in range(256):
        remainder = byte
        for _ in range(8):
            remainder = (remainder >> 1) ^ (0xEDB88320 if remainder & 1 else 0)
        tables[0, byte] = remainder
    for row in range(1, slices):
        before = tables[row - 1]
        tables[row] = (before >> 8) ^ tables[0, before & 0xFF]
    return tables


_CRC = _crc_tables(8)


@kernel(_i64(_bytes, _i64, _i64, _i64))
def crc32(buffer: Bytes, start: int, stop: int, seed: int) -> int:
    """Return the CRC-32 of ``buffer[start:stop]`` as `zlib.crc32`; `seed` is the CRC of the bytes before, or 0."""
    # Eight bytes a step ("slicing by 8", Kounavis and Berry 2005): recordings check whole blocks with it.
    crc = seed ^ 0xFFFFFFFF
    at = start
    while at + 8 <= stop:
        crc = (
            _CRC[7, (crc ^ np.int64(buffer[at])) & 0xFF]
            ^ _CRC[6, ((crc >> 8) ^ np.int64(buffer[at + 1])) & 0xFF]
            ^ _CRC[5, ((crc >> 16) ^ np.int64(buffer[at + 2])) & 0xFF]
            ^ _CRC[4, ((crc >> 24) ^ np.int64(buffer[at + 3])) & 0xFF]
            ^ _CRC[3, np.int64(buffer[at + 4])]
            ^ _CRC[2, np.int64(buffer[at + 5])]
            ^ _CRC[1, np.int64(buffer[at + 6])]
            ^ _CRC[0, np.int64(buffer[at + 7])]
        )
        at += 8
    while at < stop:
        crc = (crc >> 8) ^ _CRC[0, (crc ^ np.int64(buffer[at])) & 0xFF]
        at += 1
    return crc ^ 0xFFFFFFFF


@kernel(_i64(_bytes, _i64, _i64))
def find_delimiter(buffer: Bytes, start: int, end: int) -> int:
    """Return the index of the first zero byte (frame delimiter) in ``buffer[start:end]``; -1 without a zero byte."""
    for i in range(start, end):
        if buffer[i] == 0:
            return i
    return -1


@kernel(_i64(_bytes, _i64, _i64, _bytes))
def decode_frame(buffer: Bytes, start: int, stop: int, raw: Bytes) -> int:
    """Decode the COBS bytes ``buffer[start:stop]`` (one frame without its delimiter) and check the frame's CRC.

    Header and payload are written to `raw` (at least RAW_BYTES long). Returns their length (bytes), or COBS_ERROR,
    CRC_ERROR, TOO_LONG or TOO_SHORT (all negative): the same defect that `framing.decode_frame` reports.
    """
    size = stop - start
    # The order of checks is that of `framing.decode_frame`: both must count the same defect for the same bytes.
    if size > _ENCODED_LIMIT:
        return TOO_LONG
    if size < _RAW_MINIMUM + 1:
        return TOO_SHORT
    code_at = 0
    next_code = np.int64(buffer[start])
    for i in range(1, size):
        byte = np.int64(buffer[start + i])
        if byte == 0:
            return COBS_ERROR
        if i == code_at + next_code:
            code_at = i
            next_code = byte
            raw[i - 1] = 0
        else:
            raw[i - 1] = byte
    if code_at + next_code != size:
        return COBS_ERROR
    length = size - 1 - _CRC_BYTES
    sent = np.int64(0)
    for i in range(_CRC_BYTES):
        sent |= np.int64(raw[length + i]) << (8 * i)
    if crc32(raw, 0, length, 0) != sent:
        return CRC_ERROR
    return length


@kernel(_i64(_ints, _table, _i64, _i64, _i64, _bytes))
def _open(values: Ints, layout: Ints, type_id: int, session: int, sequence: int, out: Bytes) -> int:
    """Write header and fields of a message to ``out[1:]``; return the next free index, or BAD_VALUE (< 0).

    Index 0 remains free for the first COBS code. BAD_VALUE means that a value exceeds the range of its field.
    """
    if session < 0 or session > 0xFF or sequence < 0 or sequence > 0xFFFF:
        return BAD_VALUE
    out[1] = _MAJOR
    out[2] = type_id
    out[3] = 0
    out[4] = session
    out[5] = sequence & 0xFF
    out[6] = sequence >> 8
    at = 1 + _HEADER_BYTES
    for field in range(layout.shape[0]):
        size = layout[field, 0]
        signed = layout[field, 1]
        value = values[field]
        # A u64 is limited to 63 bits: every value is an int64 here, where bit 63 is the sign.
        bits = min(8 * size - signed, 63)
        if (value >> bits) != 0 and not (signed == 1 and (value >> bits) == -1):
            return BAD_VALUE
        for k in range(size):
            out[at + k] = (value >> (8 * k)) & 0xFF
        at += size
    return at


@kernel(_i64(_bytes, _i64))
def _seal(out: Bytes, at: int) -> int:
    """Append CRC and delimiter to the message in ``out[1:at]``, COBS-encoded in place; return the length (bytes)."""
    crc = crc32(out, 1, at, 0)
    for k in range(_CRC_BYTES):
        out[at + k] = (crc >> (8 * k)) & 0xFF
    end = at + _CRC_BYTES
    code_at = 0
    for i in range(1, end):
        if out[i] == 0:
            out[code_at] = i - code_at
            code_at = i
    out[code_at] = end - code_at
    out[end] = 0
    return end + 1


@kernel(_i64(_ints, _table, _i64, _i64, _i64, _bytes))
def _encode(values: Ints, layout: Ints, type_id: int, session: int, sequence: int, out: Bytes) -> int:
    at = _open(values, layout, type_id, session, sequence, out)
    return int(at) if at < 0 else int(_seal(out, at))


@kernel(_i64(_bytes, _i64, _i64), inline=True)
def _read_unsigned(raw: Bytes, at: int, size: int) -> int:
    value = np.int64(0)
    for k in range(size):
        value |= np.int64(raw[at + k]) << (8 * k)
    return int(value)


@kernel(_i64(_bytes, _i64, _i64), inline=True)
def _read_signed(raw: Bytes, at: int, size: int) -> int:
    value = _read_unsigned(raw, at, size)
    return int(value - ((value >> (8 * size - 1)) << (8 * size)))


@kernel(_i64(_bytes, _i64, _table, _i64, _i64, _ints, _ints))
def _decode(
    raw: Bytes, length: int, layout: Ints, limit: int, type_id: int, header: Ints, values: Ints
) -> int:
    """Decode header and fixed fields of a message of type `type_id` with at most `limit` bytes of payload.

    Returns 0, FOREIGN_MAJOR (other protocol version), OTHER_TYPE (of message) or BAD_PAYLOAD (wrong length); `values`
    is written only if the result is 0.
    """
    header[HEAD.major] = np.int64(raw[0])
    header[HEAD.type_id] = np.int64(raw[1])
    header[HEAD.flags] = np.int64(raw[2])
    header[HEAD.session] = np.int64(raw[3])
    header[HEAD.sequence] = np.int64(raw[4]) | (np.int64(raw[5]) << 8)
    if header[HEAD.major] != _MAJOR:
        return FOREIGN_MAJOR
    if header[HEAD.type_id] != type_id:
        return OTHER_TYPE
    needed = np.int64(0)
    for field in range(layout.shape[0]):
        needed += layout[field, 0]
    payload = length - _HEADER_BYTES
    if payload < needed or payload > limit:
        return BAD_PAYLOAD
    at = _HEADER_BYTES
    for field in range(layout.shape[0]):
        size = layout[field, 0]
        values[field] = (
            _read_signed(raw, at, size) if layout[field, 1] == 1 else _read_unsigned(raw, at, size)
        )
        at += size
    return 0


@kernel(_i64(_i64, _i64, _ints, _bytes))
def encode_command(session: int, sequence: int, values: Ints, out: Bytes) -> int:
    """Encode a COMMAND message with its field `values` into `out`; return its length (bytes), or BAD_VALUE (< 0).

    `values` are in the order of `COMMAND`; `out` has at least FRAME_BYTES bytes. BAD_VALUE means that a value exceeds
    the range of its field.
    """
    return _encode(values, _COMMAND_LAYOUT, _COMMAND_TYPE, session, sequence, out)


@kernel(_i64(_i64, _i64, _ints, _bytes))
def encode_state(session: int, sequence: int, values: Ints, out: Bytes) -> int:
    """Encode a STATE message with its field `values` into `out`; return its length (bytes), < 0 for a bad value."""
    return _encode(values, _STATE_LAYOUT, _STATE_TYPE, session, sequence, out)


@kernel(_i64(_bytes, _i64, _ints, _ints))
def decode_state(raw: Bytes, length: int, header: Ints, values: Ints) -> int:
    """Decode a STATE message from `raw` and `length`, the results of `decode_frame`.

    Returns 0, FOREIGN_MAJOR (other protocol version), OTHER_TYPE (not a STATE message) or BAD_PAYLOAD (wrong length).
    `header` (in the order of `HEAD`) is always written, `values` (in the order of `STATE`) only if the result is 0.
    """
    return _decode(raw, length, _STATE_LAYOUT, _PAYLOAD_LIMIT, _STATE_TYPE, header, values)


@kernel(_i64(_i64, _i64, _ints, _bytes))
def encode_get_time(session: int, sequence: int, values: Ints, out: Bytes) -> int:
    """Encode a GET_TIME message with its field `values` into `out`; return its length (bytes), < 0 for a bad value."""
    return _encode(values, _GET_TIME_LAYOUT, _GET_TIME_TYPE, session, sequence, out)


@kernel(_i64(_bytes, _i64, _ints, _ints))
def decode_time(raw: Bytes, length: int, header: Ints, values: Ints) -> int:
    """Decode a TIME message to `header` and `values`; return 0, or < 0 for a wrong version, message type or length."""
    return _decode(raw, length, _TIME_LAYOUT, _PAYLOAD_LIMIT, _TIME_TYPE, header, values)


@kernel(_i64(_bytes, _i64, _ints, _ints))
def decode_ack(raw: Bytes, length: int, header: Ints, values: Ints) -> int:
    """Decode an ACK message to `header` and `values`; return 0, or < 0 for a wrong version, message type or length."""
    return _decode(raw, length, _ACK_LAYOUT, _PAYLOAD_LIMIT, _ACK_TYPE, header, values)


@kernel(_i64(_i64, _i64, _ints, _bytes))
def encode_set_begin(session: int, sequence: int, values: Ints, out: Bytes) -> int:
    """Encode a SET_BEGIN message with its field `values` into `out`; return its length (bytes), < 0 for a bad value."""
    return _encode(values, _SET_BEGIN_LAYOUT, SET_BEGIN_TYPE, session, sequence, out)


@kernel(_i64(_i64, _i64, _ints, _bytes))
def encode_set_commit(session: int, sequence: int, values: Ints, out: Bytes) -> int:
    """Encode a SET_COMMIT message with its field `values` into `out`; return its length (bytes), < 0 if invalid."""
    return _encode(values, _SET_COMMIT_LAYOUT, SET_COMMIT_TYPE, session, sequence, out)


@kernel(_i64(_i64, _i64, _ints, _bytes, _i64, _i64, _bytes))
def encode_set_chunk(
    session: int, sequence: int, values: Ints, block: Bytes, start: int, stop: int, out: Bytes
) -> int:
    """Encode a SET_CHUNK message with the data ``block[start:stop]`` into `out` (at least FRAME_BYTES long).

    Returns the message's length (bytes), or BAD_VALUE (negative) if a value exceeds the range of its field or the data
    exceed `CHUNK_BYTES`.
    """
    if stop - start > CHUNK_BYTES:
        return BAD_VALUE
    at = _open(values, _SET_CHUNK_LAYOUT, SET_CHUNK_TYPE, session, sequence, out)
    if at < 0:
        return int(at)
    for i in range(start, stop):
        out[at] = block[i]
        at += 1
    return int(_seal(out, at))


@kernel(_i64(_bytes, _i64, _ints, _ints, _rows))
def decode_batch(raw: Bytes, length: int, header: Ints, values: Ints, samples: Ints) -> int:
    """Decode header, fields and samples of a BATCH: several samples that a law on the device sends in one message.

    Parameters
    ----------
    raw, length
        Bytes and length of header and payload, from `decode_frame`.
    header, values
        Arrays that are filled with the header (indices `HEAD`) and the fields (indices `BATCH`).
    samples
        Array of `MOST_SAMPLES` rows. Each row is filled with encoder count (it may wrap at 32 bits), commanded current
        and measured current (quanta), at the indices `SAMPLE`; a field that the batch does not contain is 0.

    Returns
    -------
    int
        Number of samples, at least 1; or negative: FOREIGN_MAJOR (other protocol version), OTHER_TYPE (of message),
        BAD_PAYLOAD (no sample, or not a whole number of samples), BAD_VALUE (unknown sample layout).
    """
    found = _decode(raw, length, _BATCH_LAYOUT, _BATCH_LIMIT, _BATCH_TYPE, header, values)
    if found != 0:
        return int(found)
    layout = values[BATCH.layout]
    if layout >= _SAMPLE_BYTES.shape[0]:
        return BAD_VALUE
    difference = _SAMPLE_BYTES[layout, SAMPLE.count]
    commanded = _SAMPLE_BYTES[layout, SAMPLE.current_commanded]
    measured = _SAMPLE_BYTES[layout, SAMPLE.current_measured]
    size = difference + commanded + measured
    data = length - _HEADER_BYTES - _BATCH_FIXED
    if data == 0 or data % size != 0:
        return BAD_PAYLOAD
    count = values[BATCH.base_count]
    at = _HEADER_BYTES + _BATCH_FIXED
    for i in range(data // size):
        # The sum may pass 32 bits, where the device's own counter wraps: the next line wraps it as well.
        count += _read_signed(raw, at, difference)
        samples[i, SAMPLE.count] = ((count + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)
        samples[i, SAMPLE.current_commanded] = _read_signed(raw, at + difference, commanded)
        samples[i, SAMPLE.current_measured] = (
            _read_signed(raw, at + difference + commanded, measured) if measured > 0 else 0
        )
        at += size
    return int(data // size)
