"""Frames arrive however the bytes are split, garbage is dropped, and no flipped bit ever becomes a message."""

from itertools import pairwise
from zlib import crc32

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.errors import LocalProtocolError
from firmware_protocol.framing import (
    CRC_BYTES,
    ENCODED_LIMIT,
    HEADER_BYTES,
    RAW_LIMIT,
    SHORT_RAW_LIMIT,
    Defect,
    FrameError,
    FrameSplitter,
    decode_frame,
    encode_frame,
)

raw_frames = st.binary(min_size=HEADER_BYTES, max_size=RAW_LIMIT - CRC_BYTES)
zero_rich = st.lists(
    st.sampled_from([0, 0, 1, 255]), min_size=HEADER_BYTES, max_size=RAW_LIMIT - CRC_BYTES
).map(bytes)


def reference_cobs(raw: bytes) -> bytes:
    """Encode by COBS as its paper defines it (Cheshire and Baker 1999), byte by byte; for short frames."""
    out, block = bytearray(), bytearray()
    for byte in raw:
        if byte:
            block.append(byte)
        else:
            out += bytes([len(block) + 1]) + block
            block.clear()
    return bytes(out + bytes([len(block) + 1]) + block)


@given(raw_frames | zero_rich)
def test_a_frame_comes_back(raw: bytes) -> None:
    frame = encode_frame(raw)
    assert frame == reference_cobs(raw + crc32(raw).to_bytes(4, "little")) + b"\0"
    assert frame.index(0) == len(frame) - 1
    assert decode_frame(frame[:-1]) == raw


@given(st.binary(max_size=ENCODED_LIMIT + 5))
def test_only_what_the_encoder_makes_is_decoded(encoded: bytes) -> None:
    try:
        raw = decode_frame(encoded)
    except FrameError:
        return
    assert encode_frame(raw) == encoded + b"\0"


def test_the_crc_is_the_one_of_the_catalogue() -> None:
    # "123456789" is the check input of every CRC catalogue; for CRC-32/ISO-HDLC it gives 0xCBF43926.
    assert encode_frame(b"123456789") == b"\x0e123456789\x26\x39\xf4\xcb\x00"


def test_a_short_frame_fits_one_full_speed_usb_packet() -> None:
    assert len(encode_frame(b"\x55" * (SHORT_RAW_LIMIT - CRC_BYTES))) <= 64


def test_the_longest_frame_has_no_block_that_cobs_would_split() -> None:
    raw, splitter = b"\x55" * (RAW_LIMIT - CRC_BYTES), FrameSplitter()
    frame = encode_frame(raw)
    assert len(frame) == RAW_LIMIT + 2
    assert [found for byte in frame for found in splitter.feed(bytes([byte]))] == [raw]
    assert frame[0] < 0xFF


@pytest.mark.parametrize("length", [0, HEADER_BYTES - 1, RAW_LIMIT - CRC_BYTES + 1])
def test_impossible_lengths_are_not_sent(length: int) -> None:
    with pytest.raises(LocalProtocolError):
        encode_frame(bytes(length))


@pytest.mark.parametrize(
    ("encoded", "defect"),
    [
        (b"\x01" * (ENCODED_LIMIT + 1), Defect.TOO_LONG),
        (b"\x01" * (HEADER_BYTES + CRC_BYTES), Defect.TOO_SHORT),
        (b"\x02\x00" + b"\x01" * 12, Defect.COBS),
        (b"\xff" + b"\x01" * 20, Defect.COBS),
        (b"\x01" * 20, Defect.CRC),
    ],
)
def test_each_defect_has_its_name(encoded: bytes, defect: Defect) -> None:
    with pytest.raises(FrameError) as caught:
        decode_frame(encoded)
    assert caught.value.defect is defect


FRAMES = [
    bytes([1, 0x40, 0, 9, 1, 0]) + bytes(10),
    bytes([1, 0x41, 0, 9, 255, 255]) + bytes(range(34)),
    bytes([1, 0x41, 0, 9, 0, 0]) + bytes(34),
    bytes([1, 0x06, 0, 0, 3, 0]) + b"\xff" * 50,
]


@pytest.mark.parametrize("raw", FRAMES, ids=["command", "state", "zeros", "ones"])
def test_every_single_bit_error_on_the_wire_is_detected(raw: bytes) -> None:
    # The frame travels between two others, so that a flipped delimiter may join it to a neighbour.
    before, after = encode_frame(FRAMES[0]), encode_frame(FRAMES[1])
    wire = bytearray(before + encode_frame(raw) + after)
    innocent = [FRAMES[0], raw, FRAMES[1]]
    for bit in range(8 * len(wire)):
        wire[bit // 8] ^= 1 << bit % 8
        splitter = FrameSplitter()
        frames = splitter.feed(bytes(wire) + b"\0")
        wire[bit // 8] ^= 1 << bit % 8
        statistics = splitter.statistics
        assert all(frame in innocent for frame in frames)
        assert 1 <= len(frames) < 3, "a flip costs one frame, or two where it joins them"
        assert statistics.crc_errors + statistics.framing_errors >= 1


def test_every_double_bit_error_in_a_command_is_detected() -> None:
    frame = bytearray(encode_frame(FRAMES[0]))
    bits = 8 * (len(frame) - 1)
    for first in range(bits):
        for second in range(first):
            frame[first // 8] ^= 1 << first % 8
            frame[second // 8] ^= 1 << second % 8
            assert FrameSplitter().feed(bytes(frame)) == []
            frame[first // 8] ^= 1 << first % 8
            frame[second // 8] ^= 1 << second % 8


@given(st.lists(raw_frames, max_size=6), st.lists(st.integers(0, 2000), max_size=8))
def test_any_cutting_gives_the_same_frames(raws: list[bytes], cuts: list[int]) -> None:
    wire = b"".join(encode_frame(raw) for raw in raws)
    edges = sorted({0, len(wire), *(cut % (len(wire) + 1) for cut in cuts)})
    splitter = FrameSplitter()
    got = [frame for a, b in pairwise(edges) for frame in splitter.feed(wire[a:b])]
    assert got == raws


def test_without_a_delimiter_memory_stays_bounded_and_one_error_is_counted() -> None:
    splitter = FrameSplitter()
    for _ in range(1000):
        assert splitter.feed(b"\x11" * 997) == []
        assert len(splitter._pending) <= ENCODED_LIMIT
    assert splitter.statistics.too_long == 1
    assert splitter.feed(b"\0" + encode_frame(FRAMES[1])) == [FRAMES[1]]


def test_empty_frames_mean_nothing() -> None:
    splitter = FrameSplitter()
    assert splitter.feed(b"\0\0\0" + encode_frame(FRAMES[0]) + b"\0\0") == [FRAMES[0]]
    assert splitter.statistics.framing_errors == 0


def test_reset_forgets_an_unfinished_frame() -> None:
    splitter = FrameSplitter()
    splitter.feed(encode_frame(FRAMES[0])[:-3])
    splitter.reset()
    assert splitter.feed(encode_frame(FRAMES[1])) == [FRAMES[1]]
    assert splitter.statistics.framing_errors == 0
