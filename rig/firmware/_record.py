"""Write and find the record that identifies a firmware image, in an ELF file, a UF2 file or plain bytes.

The record consists of sixteen magic bytes, the lengths of a JSON text and of the compressed dictionary, the CRC-32 of
text and dictionary, the text, and the dictionary. The device sends the same dictionary to its host. Build, flash and
info use it. The magic bytes must not change, or older images are not found.
"""

import json
import struct
from dataclasses import asdict, dataclass
from typing import Any
from zlib import crc32

from firmware_protocol import dictionary as dictionaries
from firmware_protocol.errors import RemoteProtocolError
from rig.core.errors import ConfigError

# "haptic-rig"; line ends and control characters that a transfer as text changes; version 1.
MAGIC = bytes.fromhex("6861 7074 6963 2d72 6967 0d0a 1a00 fe01")
_LENGTHS = struct.Struct("<3I")
HEAD_BYTES = len(MAGIC) + _LENGTHS.size


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageFacts:
    """Facts about a firmware image that are known when it is built.

    Attributes
    ----------
    package
        Version of the package that built the image.
    sources
        Hash of the C sources, 12 hexadecimal digits.
    board
        Name of the board.
    rig
        Name of the rig; an image contains the limits of one rig.
    settings
        Value of each of the board's settings (pins, scales, choices) by name.
    """

    package: str
    sources: str
    board: str
    rig: str
    settings: dict[str, int | float | str]


@dataclass(frozen=True, slots=True)
class Record:
    """The record that identifies a firmware image: facts of its build, and the compressed dictionary."""

    facts: ImageFacts
    packed: bytes

    @property
    def dictionary_hash(self) -> int:
        """Return the 64-bit hash of the device's dictionary, as the device sends it."""
        return dictionaries.dictionary_hash(self.packed)

    @property
    def dictionary(self) -> dictionaries.Dictionary:
        """Return the dictionary that the device will send; raise `ConfigError` if it cannot be decompressed or read."""
        try:
            return dictionaries.decode(self.packed)
        except RemoteProtocolError as error:
            raise ConfigError(
                f"the dictionary (parameters and ranges) in the firmware image cannot be read: {error}",
                remedy="build the image again: rig firmware build",
            ) from None


def pack(record: Record) -> bytes:
    """Return the image record as bytes; equal facts give equal bytes."""
    text = json.dumps(
        asdict(record.facts), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    ).encode()
    content = text + record.packed
    return MAGIC + _LENGTHS.pack(len(text), len(record.packed), crc32(content)) + content


def find(image: bytes, name: str) -> Record:
    """Return the record in the bytes of a firmware image; `name` is the file's name for messages.

    Raise `ConfigError` if the image contains no record, or its record is damaged.
    """
    damaged = False
    at = image.find(MAGIC)
    while at >= 0:
        record = _read(image, at)
        if record is not None:
            return record
        damaged = True
        at = image.find(MAGIC, at + 1)
    if damaged:
        raise ConfigError(
            f"{name} is damaged: the checksum of its image record is wrong",
            remedy="build the image again: rig firmware build",
        )
    raise ConfigError(
        f"{name} is not firmware of this project: it contains no image record",
        remedy="give an image made by rig firmware build (.elf, .uf2 or .bin)",
    )


def _read(image: bytes, at: int) -> Record | None:
    """Return the image record at the byte offset `at`, or None if these bytes are not a valid record."""
    if len(image) < at + HEAD_BYTES:
        return None
    text_bytes, packed_bytes, crc = _LENGTHS.unpack_from(image, at + len(MAGIC))
    content = image[at + HEAD_BYTES : at + HEAD_BYTES + text_bytes + packed_bytes]
    if len(content) != text_bytes + packed_bytes or crc32(content) != crc:
        return None
    try:
        facts: dict[str, Any] = json.loads(content[:text_bytes])
        known = {name: facts[name] for name in ImageFacts.__dataclass_fields__}  # a newer version has more
        return Record(ImageFacts(**known), content[text_bytes:])
    except (ValueError, KeyError, TypeError):
        return None
