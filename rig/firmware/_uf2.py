"""Read and write UF2, the file format that a boot ROM with a USB drive accepts.

A file consists of independent blocks of 512 bytes: two magic numbers, flags, an address in the processor's memory, up
to 476 bytes of data, the block's number, the family of the processor, and a third magic number. Source: the UF2
specification (github.com/microsoft/uf2). Build and flash use it. It must not depend on a board.
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from rig.core.errors import ConfigError

BLOCK_BYTES = 512
# The RP2040's boot ROM accepts only 256 bytes a block, at addresses that are multiples of 256 (RP2040 data sheet,
# section 2.8.4.2, "UF2 format details").
PAYLOAD_BYTES = 256
DATA_ROOM = 476
MAGIC_FIRST, MAGIC_SECOND, MAGIC_LAST = 0x0A324655, 0x9E5D5157, 0x0AB16F30
FAMILY_PRESENT = 0x00002000  # the last word of the head is a family, not a length
NOT_FOR_FLASH = 0x00000001  # the block contains a comment
RP2040 = 0xE48BFF56
FAMILIES = {RP2040: "RP2040", 0xE48BFF59: "RP2350, Arm, secure", 0xE48BFF57: "RP2xxx, absolute"}

_HEAD = struct.Struct("<8I")


@dataclass(frozen=True, slots=True)
class Piece:
    """Consecutive bytes of a program, and their address in the processor's memory."""

    address: int
    data: bytes


class _Block(NamedTuple):
    """A block of a UF2 file; `total` counts all blocks, and `piece` is None if the block is not for the flash."""

    number: int
    total: int
    family: int | None
    piece: Piece | None


@dataclass(frozen=True, slots=True)
class Uf2:
    """Contents of a UF2 file: pieces of consecutive bytes, and the processor family's number (None if not given)."""

    pieces: tuple[Piece, ...]
    family: int | None


def is_uf2(content: bytes) -> bool:
    """Return True if a file's content begins with the magic numbers of UF2."""
    return content[:8] == struct.pack("<2I", MAGIC_FIRST, MAGIC_SECOND)


def write_uf2(pieces: Iterable[Piece], family: int) -> bytes:
    """Return the bytes of a UF2 file for a processor family.

    The pieces of the program must not overlap; each is padded with zeros to whole pages of 256 bytes.
    """
    pages: dict[int, bytearray] = {}
    for piece in pieces:
        for offset, byte in enumerate(piece.data):
            at = piece.address + offset
            pages.setdefault(at - at % PAYLOAD_BYTES, bytearray(PAYLOAD_BYTES))[at % PAYLOAD_BYTES] = byte
    return b"".join(
        _HEAD.pack(
            MAGIC_FIRST, MAGIC_SECOND, FAMILY_PRESENT, address, PAYLOAD_BYTES, number, len(pages), family
        )
        + bytes(page).ljust(DATA_ROOM, b"\0")
        + struct.pack("<I", MAGIC_LAST)
        for number, (address, page) in enumerate(sorted(pages.items()))
    )


def read_uf2(content: bytes, name: str) -> Uf2:
    """Return the program in the bytes of a UF2 file; `name` is the file's name for messages.

    Raise `ConfigError` if the file is not a UF2 file, is damaged (a magic number or a block is missing), or is for two
    processor families.
    """
    if not content or len(content) % BLOCK_BYTES:
        raise _damage_error(
            name, f"{len(content)} bytes are not a multiple of {BLOCK_BYTES}, the size of a block"
        )
    blocks = [_read_block(content[at : at + BLOCK_BYTES], name) for at in range(0, len(content), BLOCK_BYTES)]
    if any((block.number, block.total) != (place, len(blocks)) for place, block in enumerate(blocks)):
        raise _damage_error(name, "blocks are missing or out of order")
    families = {block.family for block in blocks}
    if len(families) != 1:
        raise ConfigError(
            f"{name} contains images for several processors",
            remedy="give a UF2 file with an image for a single processor",
        )
    return Uf2(_join(block.piece for block in blocks if block.piece is not None), families.pop())


def _read_block(block: bytes, name: str) -> _Block:
    first, second, flags, address, size, number, total, family = _HEAD.unpack_from(block)
    (last,) = struct.unpack_from("<I", block, BLOCK_BYTES - 4)
    if (first, second, last) != (MAGIC_FIRST, MAGIC_SECOND, MAGIC_LAST):
        raise _damage_error(name, "a block has wrong magic numbers")
    if size > DATA_ROOM:
        raise _damage_error(name, f"block {number} has an invalid size of {size} bytes")
    piece = None if flags & NOT_FOR_FLASH else Piece(address, block[_HEAD.size : _HEAD.size + size])
    return _Block(number, total, family if flags & FAMILY_PRESENT else None, piece)


def _join(pieces: Iterable[Piece]) -> tuple[Piece, ...]:
    joined: list[Piece] = []
    for piece in sorted(pieces, key=lambda piece: piece.address):
        if joined and joined[-1].address + len(joined[-1].data) == piece.address:
            joined[-1] = Piece(joined[-1].address, joined[-1].data + piece.data)
        else:
            joined.append(piece)
    return tuple(joined)


def _damage_error(name: str, why: str) -> ConfigError:
    return ConfigError(f"{name} is not a valid UF2 file: {why}", remedy="build it again: rig firmware build")
