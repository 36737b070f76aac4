"""Blocks reach the device completely or not at all, in any order of their chunks; pages are read to the end."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.errors import RemoteProtocolError
from firmware_protocol.faults import Status
from firmware_protocol.messages import SetBegin, SetChunk, SetCommit
from firmware_protocol.parameters import BLOCK_LIMIT
from firmware_protocol.transaction import CHUNK_BYTES
from firmware_protocol.transfer import Assembler, PageReader, page, set_parameters

blocks = st.binary(max_size=BLOCK_LIMIT)


def give(assembler: Assembler, message: SetBegin | SetChunk | SetCommit) -> tuple[Status, bytes]:
    if isinstance(message, SetBegin):
        return assembler.begin(message), b""
    if isinstance(message, SetChunk):
        return assembler.chunk(message), b""
    return assembler.commit(message)


@given(blocks, st.integers(0, 65535), st.randoms(use_true_random=False))
def test_a_block_arrives_in_any_order_with_repeats(block: bytes, nonce: int, shuffle: random.Random) -> None:
    begin, *chunks, commit = set_parameters(block, nonce)
    chunks = chunks + shuffle.sample(chunks, len(chunks) // 2)
    shuffle.shuffle(chunks)
    assembler = Assembler()
    for message in (begin, *chunks, begin):
        assert give(assembler, message) == (Status.OK, b"")
    assert give(assembler, commit) == (Status.OK, block)
    assert give(assembler, commit) == (Status.INCOMPLETE, b""), "a block is handed out once"


@given(st.binary(min_size=1, max_size=BLOCK_LIMIT), st.data())
def test_a_missing_chunk_is_asked_for(block: bytes, data: st.DataObject) -> None:
    begin, *chunks, commit = set_parameters(block, 7)
    missing = chunks.pop(data.draw(st.integers(0, len(chunks) - 1)))
    assembler = Assembler()
    for message in (begin, *chunks):
        give(assembler, message)
    assert give(assembler, commit) == (Status.INCOMPLETE, b"")
    give(assembler, missing)
    assert give(assembler, commit) == (Status.OK, block)


def test_another_nonce_starts_afresh() -> None:
    assembler = Assembler()
    old_begin, old_chunk, _ = set_parameters(b"old configuration", 1)
    begin, chunk, commit = set_parameters(b"new configuration", 2)
    give(assembler, old_begin)
    give(assembler, begin)
    assert give(assembler, old_chunk)[0] is Status.INCOMPLETE
    give(assembler, chunk)
    assert give(assembler, commit) == (Status.OK, b"new configuration")


def test_nothing_is_taken_before_begin_or_beyond_the_announced_length() -> None:
    assembler = Assembler(limit=100)
    assert assembler.chunk(SetChunk(1, 0, b"x")) is Status.INCOMPLETE
    assert assembler.commit(SetCommit(1)) == (Status.INCOMPLETE, b"")
    assert assembler.begin(SetBegin(1, 101, 0)) is Status.BAD_LENGTH
    assert assembler.begin(SetBegin(1, 4, 0)) is Status.OK
    assert assembler.chunk(SetChunk(1, 3, b"xy")) is Status.BAD_LENGTH
    assert assembler.chunk(SetChunk(1, 65535, b"")) is Status.BAD_LENGTH


def test_a_wrong_crc_refuses_the_whole_block() -> None:
    begin, chunk, commit = set_parameters(b"configuration", 1)
    assert isinstance(begin, SetBegin)
    assembler = Assembler()
    give(assembler, SetBegin(1, begin.length, begin.crc ^ 1))
    give(assembler, chunk)
    assert give(assembler, commit) == (Status.BAD_CRC, b"")


@given(st.binary(max_size=500), st.integers(1, CHUNK_BYTES))
def test_pages_add_up(content: bytes, size: int) -> None:
    reader = PageReader(limit=500)
    while not reader.complete:
        offset = reader.offset
        for _ in range(2):  # a page that comes twice changes nothing
            reader.add(total=len(content), fingerprint=9, offset=offset, data=page(content, offset, size))
    assert reader.content == content


@pytest.mark.parametrize(
    "second",
    [
        {"total": 11, "fingerprint": 1, "offset": 4, "data": b"efgh"},  # another length
        {"total": 10, "fingerprint": 2, "offset": 4, "data": b"efgh"},  # another content
        {"total": 10, "fingerprint": 1, "offset": 5, "data": b"fgh"},  # a hole
        {"total": 10, "fingerprint": 1, "offset": 4, "data": b""},  # no progress: would never end
        {"total": 10, "fingerprint": 1, "offset": 4, "data": b"efghijk"},  # longer than announced
    ],
)
def test_pages_that_do_not_fit_together_are_the_peers_fault(second: dict[str, object]) -> None:
    reader = PageReader(limit=100)
    reader.add(total=10, fingerprint=1, offset=0, data=b"abcd")
    with pytest.raises(RemoteProtocolError):
        reader.add(**second)  # type: ignore[arg-type]


def test_a_reply_without_bound_is_refused() -> None:
    with pytest.raises(RemoteProtocolError, match="above the limit of 100"):
        PageReader(limit=100).add(total=101, fingerprint=1, offset=0, data=b"a")
