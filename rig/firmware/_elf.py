"""Read the segments of an ELF program: which bytes belong to which address, and how much memory the program uses.

Only 32-bit little-endian files with program headers are read (System V ABI, chapters 4 and 5). Build and flash use it.
It must not change a program, except for the checksum in `seal`.
"""

import struct
from dataclasses import dataclass
from zlib import crc32

from rig.core.errors import ConfigError
from rig.firmware._uf2 import Piece

_LOAD = 1  # type of a segment that is put into memory
_HEADER = struct.Struct("<28xI10xHH6x")  # e_phoff, e_phentsize, e_phnum
_SEGMENT = struct.Struct("<8I")
_WORD = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class Segment:
    """A segment of a program: bytes with their load address, offset in the file, run-time address, size in memory."""

    offset: int
    load: Piece
    address: int
    memory_bytes: int


def seal(content: bytes, behind: int) -> bytes:
    """Return the program with its last loaded word set to the CRC-32 of the image.

    `content` are the bytes of the ELF file. The CRC leaves out the first `behind` bytes of the image, and the last
    word.
    """
    segments = read_segments(content, "the new program")
    image = flat(tuple(segment.load for segment in segments if segment.load.data))
    last = max((segment for segment in segments if segment.load.data), key=lambda one: one.load.address)
    at = last.offset + len(last.load.data) - _WORD.size
    return content[:at] + _WORD.pack(crc32(image[behind : -_WORD.size])) + content[at + _WORD.size :]


def read_segments(content: bytes, name: str) -> tuple[Segment, ...]:
    """Return the segments of an ELF file in order of load address; `ConfigError` with the file's `name` if damaged."""
    try:
        at, size, count = _HEADER.unpack_from(content)
        segments = [_SEGMENT.unpack_from(content, at + number * size) for number in range(count)]
    except struct.error as error:
        raise ConfigError(
            f"{name} is a damaged ELF program: {error}", remedy="build it again: rig firmware build"
        ) from None
    found = []
    for kind, offset, address, load, file_bytes, memory_bytes, *_ in segments:
        data = content[offset : offset + file_bytes]
        if len(data) != file_bytes:
            raise ConfigError(
                f"{name} is a damaged ELF program: its end is missing",
                remedy="build it again: rig firmware build",
            )
        if kind == _LOAD and memory_bytes:
            found.append(Segment(offset, Piece(load, data), address, memory_bytes))
    return tuple(sorted(found, key=lambda segment: segment.load.address))


def flat(pieces: tuple[Piece, ...]) -> bytes:
    """Return the pieces of a program as one block of bytes, first to last address; gaps are 0xFF, like erased flash."""
    if not pieces:
        return b""
    first = min(piece.address for piece in pieces)
    image = bytearray(b"\xff" * (max(piece.address + len(piece.data) for piece in pieces) - first))
    for piece in pieces:
        image[piece.address - first : piece.address - first + len(piece.data)] = piece.data
    return bytes(image)
