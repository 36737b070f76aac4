"""The compiled codec equals the readable one: the same bytes, and the same rejected frames."""

import zlib
from dataclasses import astuple
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import framing
from firmware_protocol.errors import LocalProtocolError, RemoteProtocolError
from firmware_protocol.framing import FrameError, encode_frame
from firmware_protocol.messages import (
    BATCH_LAYOUTS,
    MAJOR,
    Ack,
    Batch,
    Command,
    GetTime,
    Message,
    SetBegin,
    SetChunk,
    SetCommit,
    State,
    Time,
)
from firmware_protocol.packing import (
    HEADER,
    LAYOUT_OF,
    data_limit,
    pack,
    pack_batch_samples,
    unpack,
    unpack_batch_samples,
)
from rig.realtime import codec
from tests.conformance.wire_strategies import any_message, integers_of, messages_of

SESSIONS = st.integers(0, 255)
SEQUENCES = st.integers(0, 65535)
ENCODE = {Command: codec.encode_command, State: codec.encode_state}
streams = st.sampled_from([Command, State]).flatmap(messages_of)
LONG = st.integers(0, 2**63 - 1)  # of a u64, what an int64 holds
TIMES = st.builds(Time, st.integers(0, 65535), LONG, LONG, LONG)


def buffer_of(data: bytes) -> Any:
    return np.frombuffer(data, dtype=np.uint8).copy()


def compiled_frame(message: Message, session: int, sequence: int) -> bytes:
    out = np.full(codec.FRAME_BYTES, 0xAA, dtype=np.uint8)
    values = np.array(astuple(message), dtype=np.int64)  # type: ignore[call-overload]
    size = ENCODE[type(message)](session, sequence, values, out)
    assert size > 0
    return out[:size].tobytes()


def compiled_raw(encoded: bytes) -> bytes | int:
    raw = np.zeros(codec.RAW_BYTES, dtype=np.uint8)
    length = codec.decode_frame(buffer_of(encoded), 0, len(encoded), raw)
    return raw[:length].tobytes() if length >= 0 else int(length)


def readable_raw(encoded: bytes) -> bytes | int:
    try:
        return framing.decode_frame(encoded)
    except FrameError as error:
        return -int(error.defect)


@given(streams, SESSIONS, SEQUENCES)
def test_both_encoders_make_the_same_bytes(message: Message, session: int, sequence: int) -> None:
    readable = encode_frame(pack(message, session=session, sequence=sequence))
    assert compiled_frame(message, session, sequence) == readable


@given(messages_of(State), SESSIONS, SEQUENCES, st.binary(max_size=6))
def test_both_decoders_read_the_same(message: Message, session: int, sequence: int, tail: bytes) -> None:
    encoded = encode_frame(pack(message, session=session, sequence=sequence) + tail)[:-1]
    raw = np.zeros(codec.RAW_BYTES, dtype=np.uint8)
    header, values = np.zeros(5, dtype=np.int64), np.zeros(len(astuple(message)), dtype=np.int64)  # type: ignore[call-overload]
    length = codec.decode_frame(buffer_of(b"\xee" + encoded), 1, 1 + len(encoded), raw)
    assert codec.decode_state(raw, length, header, values) == 0
    read_header, read = unpack(raw[:length].tobytes())
    assert tuple(header) == read_header == (MAJOR, LAYOUT_OF[type(message)].type_id, 0, session, sequence)
    assert tuple(values) == astuple(read) == astuple(message)  # type: ignore[call-overload]


@given(st.builds(GetTime, st.integers(0, 65535), LONG), TIMES, SESSIONS, SEQUENCES)
def test_clock_exchange_is_encoded_alike(
    question: GetTime, answer: Time, session: int, sequence: int
) -> None:
    out = np.zeros(codec.FRAME_BYTES, dtype=np.uint8)
    asked = np.array(astuple(question), dtype=np.int64)
    size = codec.encode_get_time(session, sequence, asked, out)
    assert out[:size].tobytes() == encode_frame(pack(question, session=session, sequence=sequence))
    raw = buffer_of(pack(answer, session=session, sequence=sequence))
    header, values = np.zeros(5, dtype=np.int64), np.zeros(len(codec.TIME), dtype=np.int64)
    assert codec.decode_time(raw, len(raw), header, values) == 0
    assert tuple(values) == astuple(answer)
    assert tuple(header)[3:] == (session, sequence)


def test_a_64_bit_value_that_is_negative_is_refused() -> None:
    values, out = np.zeros(2, dtype=np.int64), np.zeros(codec.FRAME_BYTES, dtype=np.uint8)
    values[codec.GET_TIME.host_sent] = -1
    assert codec.encode_get_time(0, 0, values, out) == codec.BAD_VALUE


def broken(draw: st.DrawFn) -> bytes:
    encoded = bytearray(encode_frame(pack(draw(any_message())))[:-1])
    for _ in range(draw(st.integers(0, 3))):
        at = draw(st.integers(0, len(encoded) - 1))
        encoded[at] = draw(st.integers(0, 255))
    return bytes(encoded[: draw(st.integers(0, len(encoded)))]) + draw(
        st.sampled_from([b"", b"\x01", b"\x02\x00"])
    )


@given(
    st.composite(broken)() | st.binary(max_size=300) | st.lists(st.integers(0, 3), max_size=300).map(bytes)
)
def test_both_agree_on_every_corrupt_frame_and_on_its_defect(encoded: bytes) -> None:
    assert compiled_raw(encoded) == readable_raw(encoded)


@given(st.integers(0, 3), st.integers(0, 255), st.binary(max_size=60))
def test_both_refuse_the_same_payloads(major: int, type_id: int, payload: bytes) -> None:
    raw = HEADER.pack(major, type_id, 0, 0, 0) + payload
    values, header = np.zeros(16, dtype=np.int64), np.zeros(5, dtype=np.int64)
    result = codec.decode_state(buffer_of(raw), len(raw), header, values)
    if major != MAJOR:
        assert result == codec.FOREIGN_MAJOR
    elif type_id != LAYOUT_OF[State].type_id:
        assert result == codec.OTHER_TYPE
    else:
        try:
            unpack(raw)
        except RemoteProtocolError:
            assert result == codec.BAD_PAYLOAD
        else:
            assert result == 0


@pytest.mark.parametrize("length", [44, 45, 46, 56, 57, 80])
def test_lengths_of_a_state_at_both_limits(length: int) -> None:
    raw = HEADER.pack(MAJOR, LAYOUT_OF[State].type_id, 0, 0, 0) + bytes(length - 6)
    values, header = np.zeros(16, dtype=np.int64), np.zeros(5, dtype=np.int64)
    result = codec.decode_state(buffer_of(raw), len(raw), header, values)
    assert result == (0 if 45 <= length <= 56 else codec.BAD_PAYLOAD)


@given(
    st.integers(-(2**40), 2**40) | st.integers(-(2**15) - 2, 2**15 + 2), st.sampled_from(codec.STATE._fields)
)
def test_a_value_that_does_not_fit_is_refused_by_both(value: int, name: str) -> None:
    fields = dict.fromkeys(codec.STATE._fields, 0) | {name: value}
    out = np.zeros(codec.FRAME_BYTES, dtype=np.uint8)
    result = codec.encode_state(0, 0, np.array(list(fields.values()), dtype=np.int64), out)
    try:
        readable = encode_frame(pack(State(**fields)))
    except LocalProtocolError:
        assert result == codec.BAD_VALUE
    else:
        assert out[:result].tobytes() == readable


def test_session_and_sequence_must_fit_too() -> None:
    values, out = np.zeros(5, dtype=np.int64), np.zeros(codec.FRAME_BYTES, dtype=np.uint8)
    for session, sequence in ((256, 0), (-1, 0), (0, 65536), (0, -1)):
        assert codec.encode_command(session, sequence, values, out) == codec.BAD_VALUE


def test_named_places_are_those_of_the_messages() -> None:
    assert codec.COMMAND._fields == tuple(Command.__dataclass_fields__)
    assert codec.STATE._fields == tuple(State.__dataclass_fields__)
    assert codec.STATE.count == list(State.__dataclass_fields__).index("count")


@given(st.binary(max_size=300), st.binary(max_size=40), st.integers(0, 2**32 - 1))
def test_the_crc_is_zlibs_also_in_pieces(data: bytes, more: bytes, seed: int) -> None:
    assert codec.crc32(buffer_of(data), 0, len(data), seed) == zlib.crc32(data, seed)
    first = codec.crc32(buffer_of(data), 0, len(data), 0)
    assert codec.crc32(buffer_of(b"x" + more), 1, 1 + len(more), first) == zlib.crc32(data + more)


@given(st.binary(max_size=50), st.integers(0, 50), st.integers(0, 50))
def test_the_delimiter_is_found(data: bytes, a: int, b: int) -> None:
    start, end = sorted((min(a, len(data)), min(b, len(data))))
    assert codec.find_delimiter(buffer_of(data), start, end) == data.find(0, start, end)


def wrap_count(count: int) -> int:
    """Return a count as the 32-bit counter of an encoder shows it."""
    return (count + (1 << 31)) % (1 << 32) - (1 << 31)


@st.composite
def batches(draw: st.DrawFn) -> Batch:
    """Generate a batch of any layout with at most as many samples as fit."""
    layout = draw(st.sampled_from(sorted(BATCH_LAYOUTS)))
    sample = st.tuples(*(integers_of(ctype) for ctype in BATCH_LAYOUTS[layout]))
    size = len(pack_batch_samples(layout, [(0,) * len(BATCH_LAYOUTS[layout])]))
    samples = draw(st.lists(sample, min_size=1, max_size=data_limit(Batch) // size))
    first, time, base = draw(integers_of("u32")), draw(integers_of("u32")), draw(integers_of("i32"))
    return Batch(first, time, base, layout, pack_batch_samples(layout, samples))


def compiled_batch(raw: bytes) -> tuple[int, tuple[int, ...], list[list[int]]]:
    values, header = np.zeros(len(codec.BATCH), dtype=np.int64), np.zeros(5, dtype=np.int64)
    samples = np.zeros((codec.MOST_SAMPLES, len(codec.SAMPLE)), dtype=np.int64)
    buffer = np.zeros(codec.RAW_BYTES + 50, dtype=np.uint8)
    buffer[: len(raw)] = np.frombuffer(raw, np.uint8)
    found = int(codec.decode_batch(buffer, len(raw), header, values, samples))
    return found, tuple(values), samples[: max(0, found)].tolist()


@given(batches(), SESSIONS, SEQUENCES)
def test_a_batch_is_read_sample_by_sample(batch: Batch, session: int, sequence: int) -> None:
    raw = pack(batch, session=session, sequence=sequence)
    found, values, samples = compiled_batch(raw)
    expected, count = [], batch.base_count
    for difference, commanded, *measured in unpack_batch_samples(batch):
        count += difference
        expected.append([wrap_count(count), commanded, *(measured or [0])])
    assert (found, samples) == (len(expected), expected)
    assert values == (batch.first_index, batch.device_time, batch.base_count, batch.layout)


def test_the_fullest_batch_of_each_layout_has_room() -> None:
    for layout, ctypes in BATCH_LAYOUTS.items():
        sample = pack_batch_samples(layout, [(1,) * len(ctypes)])
        most = data_limit(Batch) // len(sample)
        found, _, samples = compiled_batch(pack(Batch(0, 0, 0, layout, sample * most)))
        assert found == len(samples) == most <= codec.MOST_SAMPLES
        assert samples[-1][0] == most
    assert codec.MOST_SAMPLES == 76


@given(st.integers(0, 3), st.integers(0, 255), st.binary(max_size=260))
def test_both_refuse_the_same_batches(major: int, type_id: int, payload: bytes) -> None:
    raw = HEADER.pack(major, type_id | 0x61, 0, 0, 0) + payload
    found, _, _ = compiled_batch(raw)
    if major != MAJOR:
        assert found == codec.FOREIGN_MAJOR
    elif type_id | 0x61 != LAYOUT_OF[Batch].type_id:
        assert found == codec.OTHER_TYPE
    else:
        try:
            message = unpack(raw)[1]
            assert isinstance(message, Batch)
            samples = unpack_batch_samples(message)
        except RemoteProtocolError:
            assert found in (codec.BAD_PAYLOAD, codec.BAD_VALUE)
        else:
            assert found == len(samples)


def test_samples_that_do_not_fit_their_layout_are_refused() -> None:
    with pytest.raises(LocalProtocolError, match="sample"):
        pack_batch_samples(0, [(128, 0, 0)])


@given(messages_of(SetChunk), SESSIONS, SEQUENCES)
def test_a_chunk_is_the_readable_one(chunk: SetChunk, session: int, sequence: int) -> None:
    out = np.full(codec.FRAME_BYTES, 0xAA, dtype=np.uint8)
    values = np.array([chunk.nonce, chunk.offset], dtype=np.int64)
    block = buffer_of(b"xy" + chunk.data + b"z")
    size = codec.encode_set_chunk(session, sequence, values, block, 2, 2 + len(chunk.data), out)
    assert out[:size].tobytes() == encode_frame(pack(chunk, session=session, sequence=sequence))


def test_a_chunk_longer_than_a_frame_is_refused() -> None:
    values, out = np.zeros(2, dtype=np.int64), np.zeros(codec.FRAME_BYTES, dtype=np.uint8)
    block = np.zeros(100, dtype=np.uint8)
    assert data_limit(SetChunk) == codec.CHUNK_BYTES
    assert codec.encode_set_chunk(0, 0, values, block, 0, codec.CHUNK_BYTES, out) > 0
    assert codec.encode_set_chunk(0, 0, values, block, 0, codec.CHUNK_BYTES + 1, out) == codec.BAD_VALUE
    values[0] = -1
    assert codec.encode_set_chunk(0, 0, values, block, 0, 1, out) == codec.BAD_VALUE


@given(messages_of(SetBegin), messages_of(SetCommit), SESSIONS, SEQUENCES)
def test_begin_and_commit_are_encoded_alike(
    begin: Message, commit: Message, session: int, sequence: int
) -> None:
    out = np.zeros(codec.FRAME_BYTES, dtype=np.uint8)
    for message, encode in ((begin, codec.encode_set_begin), (commit, codec.encode_set_commit)):
        size = encode(session, sequence, np.array(astuple(message), dtype=np.int64), out)  # type: ignore[call-overload]
        assert out[:size].tobytes() == encode_frame(pack(message, session=session, sequence=sequence))


@given(messages_of(Ack))
def test_an_answer_is_read_field_by_field(ack: Message) -> None:
    raw = buffer_of(pack(ack))
    values, header = np.zeros(len(codec.ACK), dtype=np.int64), np.zeros(5, dtype=np.int64)
    assert codec.decode_ack(raw, len(raw), header, values) == 0
    assert tuple(values) == astuple(ack)  # type: ignore[call-overload]
