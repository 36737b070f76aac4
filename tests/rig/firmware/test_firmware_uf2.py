"""UF2 files by their specification: blocks are read back as written, and damage is found."""

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.core.errors import ConfigError
from rig.firmware._elf import flat
from rig.firmware._uf2 import RP2040, Piece, is_uf2, read_uf2, write_uf2

FLASH = 0x1000_0000


@st.composite
def apart(draw: Any) -> Any:
    """Generate pieces that share no page of 256 bytes."""
    at, pieces = FLASH, []
    for data in draw(st.lists(st.binary(min_size=1, max_size=700), min_size=1, max_size=4)):
        pieces.append(Piece(at + draw(st.integers(0, 255)), data))
        at = (pieces[-1].address + len(data) + 255) // 256 * 256 + 256 * draw(st.integers(0, 2))
    return pieces


@given(apart())
def test_every_byte_comes_back_where_it_belongs(pieces: Any) -> None:
    read = read_uf2(write_uf2(pieces, RP2040), "a.uf2")
    assert read.family == RP2040
    memory = {p.address + i: byte for p in read.pieces for i, byte in enumerate(p.data)}
    wanted = {p.address + i: byte for p in pieces for i, byte in enumerate(p.data)}
    assert {at: memory[at] for at in wanted} == wanted
    assert all(byte == 0 for at, byte in memory.items() if at not in wanted)


def test_a_block_has_the_fields_of_the_specification() -> None:
    content = write_uf2([Piece(FLASH, bytes(range(256)) * 2)], 0xE48BFF56)
    assert len(content) == 2 * 512
    assert is_uf2(content)
    words = struct.unpack("<8I", content[512:544])
    assert words == (0x0A324655, 0x9E5D5157, 0x2000, FLASH + 256, 256, 1, 2, 0xE48BFF56)
    assert content[544:800] == bytes(range(256))
    assert content[800:1020] == bytes(220)
    assert content[1020:] == bytes.fromhex("306fb10a")


def test_a_damaged_file_or_one_that_ends_early_is_refused() -> None:
    content = write_uf2([Piece(FLASH, bytes(700))], RP2040)
    places = (0, 4, 20, 24, 512, 532, 1023, 1020)
    damaged = [content[:at] + bytes([content[at] ^ 0x55]) + content[at + 1 :] for at in places]
    for wrong in (*damaged, content[:-1], content[:-512], content[:-700]):
        with pytest.raises(ConfigError, match="not a valid UF2"):
            read_uf2(wrong, "a.uf2")


def test_blocks_for_two_processors_are_refused_and_comments_skipped() -> None:
    one, other = (bytearray(write_uf2([Piece(FLASH, b"x")], family)) for family in (RP2040, 1))
    for number, block in enumerate((one, other)):
        struct.pack_into("<2I", block, 20, number, 2)
    with pytest.raises(ConfigError, match="several processors"):
        read_uf2(bytes(one + other), "a.uf2")
    struct.pack_into("<I", other, 8, 0x2001)
    struct.pack_into("<I", other, 28, RP2040)
    assert read_uf2(bytes(one + other), "a.uf2").pieces == (Piece(FLASH, b"x".ljust(256, b"\0")),)


def test_flat_bytes_have_erased_flash_in_the_gaps() -> None:
    assert flat((Piece(8, b"ab"), Piece(12, b"c"))) == b"ab\xff\xffc"
    assert flat(()) == b""
