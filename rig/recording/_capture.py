"""The capture format (``.rigcap``): blocks of raw rows after a header that describes them; readable after a crash.

All numbers are little-endian, every part starts at a multiple of 8 bytes, every CRC is the CRC-32 of zlib (ISO-HDLC).
Each line below gives offset and size in bytes::

    file    = header  rows*  [end]

    header    0  8  magic  89 "RIGCAP" 0A
              8  4  format version (`rig.recording.header.VERSION`)
             12  4  n, length of the JSON
             16  n  JSON, UTF-8, filled up with blanks to a multiple of 8
           16+n  4  CRC of all bytes before

    rows      0  8  magic  89 "RIGROWS"
              8  8  number of this block, from 0
             16  8  number of its first row, from 0
             24  8  count of its rows
             32  8  n, bytes of its rows
             40  8  CRC of the 40 bytes before
             48  n  the rows
           48+n  8  CRC of the block's bytes before

    end       like rows, but with the magic 89 "RIGEND" 0A, the number of all rows in place of the number of the first
              row, and a JSON (the trailer) in place of the rows

The JSON of the header contains under ``schema`` the size of a row and the dtype, offset, unit and meaning of each
column: to read a capture, this page and a JSON parser suffice. The reader skips and reports a damaged block, with the
number of its rows if its own head or the next head is valid. A file without an end block was cut off: its last bytes
may be an incomplete block, all other blocks are valid. The recorder, the reader and `seal` use it. Another layout of
bytes needs another format version.
"""

import mmap
import struct
import sys
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import RecordingError
from rig.core.regular_file import TABLE_BYTES, open_regular
from rig.recording._shape import parse_json
from rig.recording.canonical import canonical_json
from rig.recording.data import Loss, Recording
from rig.recording.files import plain_errors
from rig.recording.header import VERSION, check_version, dtype_of, schema_of

SUFFIX = ".rigcap"
MAGIC = b"\x89RIGCAP\n"
ROWS_MAGIC = b"\x89RIGROWS"
END_MAGIC = b"\x89RIGEND\n"
FORGET_BLOCKS = 100
BLOCK_ROWS = 1000  # 0.25 MB a block: 20 blocks a second at 20 kHz

_FILE_HEAD = struct.Struct("<8sII")
_CRC = struct.Struct("<I")
# 64-bit integers, so that compiled code writes them as it counts. The head has a CRC of its own: a reader must be able
# to trust the length before it uses it.
_BLOCK_HEAD = struct.Struct("<8s5q")
_BLOCK_CRC = struct.Struct("<Q")
HEAD_BYTES = _BLOCK_HEAD.size
CRC_BYTES = _BLOCK_CRC.size


class BlockHead(NamedTuple):
    """Head of a block of a ``.rigcap`` file: the six 64-bit words before the rows.

    `size` is the size of the rows in bytes, `checksum` the CRC-32 of the five words before it.
    """

    magic: bytes
    number: int
    first_row: int
    rows: int
    size: int
    checksum: int


# Writing ------------------------------------------------------------------------------------------


def pack_header(header: dict[str, Any]) -> bytes:
    """Return the bytes of a ``.rigcap`` file before its first block: magic, version, header as JSON, and CRC."""
    text = _pad(canonical_json(header), _FILE_HEAD.size + _CRC.size)
    start = _FILE_HEAD.pack(MAGIC, VERSION, len(text)) + text
    return start + _CRC.pack(zlib.crc32(start))


def pack_block(magic: bytes, number: int, first_row: int, count: int, payload: bytes) -> bytes:
    """Return the bytes of one block of a ``.rigcap`` file: head (magic, number, rows, size, CRC), payload, and CRC."""
    head = _BLOCK_HEAD.pack(magic, number, first_row, count, len(payload), 0)[:-8]
    start = head + _BLOCK_CRC.pack(zlib.crc32(head)) + payload
    return start + _BLOCK_CRC.pack(zlib.crc32(start))


def pack_end(number: int, rows: int, trailer: dict[str, Any]) -> bytes:
    """Return the bytes of a ``.rigcap`` file's last block, with the trailer, after `number` blocks with `rows` rows."""
    return pack_block(END_MAGIC, number, rows, 0, _pad(canonical_json(trailer), 0))


def write_capture(file: BinaryIO, recording: Recording, *, block_rows: int = BLOCK_ROWS) -> None:
    """Write a recording as a ``.rigcap`` file; raise `RecordingError` if it was read from a damaged file."""
    if recording.lost:
        raise RecordingError(
            "a recording with lost parts (damaged or missing rows) cannot be written as a .rigcap file",
            remedy="keep the original file",
        )
    file.write(pack_header(recording.header))
    number = 0
    for first in range(0, len(recording.rows), block_rows):
        rows = recording.rows[first : first + block_rows]
        file.write(pack_block(ROWS_MAGIC, number, first, len(rows), rows.tobytes()))
        number += 1
    if recording.complete:
        file.write(pack_end(number, len(recording.rows), recording.trailer or {}))


def _pad(text: bytes, before: int) -> bytes:
    return text + b" " * (-(before + len(text)) % 8)


# Reading ------------------------------------------------------------------------------------------


@dataclass
class _Findings:
    # Byte offset and number of rows of each block.
    blocks: list[tuple[int, int]] = field(default_factory=list)
    lost: list[Loss] = field(default_factory=list)
    next_row: int = 0
    trailer: dict[str, Any] | None = None


def read_capture(path: Path, columns: Collection[str] | None = None) -> Recording:
    """Read all valid rows of a ``.rigcap`` capture, also of an incomplete file.

    If `columns` is given, the rows have only these columns; the header still describes all columns. Raise
    `RecordingError` if the file does not exist, is not a capture, or has a damaged header or another format version.
    """
    with _open_mapped(path) as data:
        header, start = _read_header(path, data)
        dtype = dtype_of(header.get("schema", {}))
        found = _walk(data, start, dtype.itemsize)
        kept = dtype if columns is None else dtype_of(schema_of(header["schema"], columns))
        rows = np.empty(sum(count for _, count in found.blocks), kept)
        filled = 0
        for number, (place, count) in enumerate(found.blocks):
            if number % FORGET_BLOCKS == 0:
                _forget(data)
            # As bytes: numpy copies a structured row field by field.
            if columns is None:
                size, start = count * dtype.itemsize, filled * dtype.itemsize
                rows.view(np.uint8)[start : start + size] = np.frombuffer(data, np.uint8, size, place)
            else:
                _copy_columns(rows[filled : filled + count], np.frombuffer(data, dtype, count, place))
            filled += count
    return Recording(header, rows, found.trailer, found.trailer is not None, tuple(found.lost), path)


def read_capture_header(path: Path) -> Recording:
    """Return the header of a ``.rigcap`` file as a recording without rows; raise `RecordingError` if it is damaged."""
    with _open_mapped(path) as data:
        header, _ = _read_header(path, data)
    return Recording(header, np.empty(0, dtype_of(header.get("schema", {}))), None, complete=False, path=path)


@contextmanager
def _open_mapped(path: Path) -> Iterator[mmap.mmap]:
    with plain_errors("read", path), open_regular(path) as file:
        if not file.read(1):
            raise RecordingError(
                f"{path} is empty", remedy="record again: the writing process ended before it wrote anything"
            )
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data


def _copy_columns(rows: NDArray[np.void], block: NDArray[np.void]) -> None:
    for name in rows.dtype.names or ():
        rows[name] = block[name]


def _forget(data: mmap.mmap) -> None:
    # Pages of the mapped file that were read count as memory of this process.
    if sys.platform == "linux":
        # madvise fails on locked memory, as while a thread of this process runs in real time.
        with suppress(OSError):
            data.madvise(mmap.MADV_DONTNEED)


def _read_header(path: Path, data: mmap.mmap) -> tuple[dict[str, Any], int]:
    if data[: len(MAGIC)] != MAGIC:
        raise RecordingError(
            f"{path} is not a recording", remedy="give a .parquet or .rigcap file that haptic-rig wrote"
        )
    damaged = RecordingError(
        f"the header of {path} is damaged",
        remedy="restore the file from a copy; without its header the rows cannot be read",
    )
    if len(data) < _FILE_HEAD.size:
        raise damaged
    _, version, length = _FILE_HEAD.unpack(data[: _FILE_HEAD.size])
    end = _FILE_HEAD.size + length
    if length > TABLE_BYTES or end + _CRC.size > len(data):
        raise damaged
    if _CRC.unpack(data[end : end + _CRC.size])[0] != zlib.crc32(data[:end]):
        raise damaged
    # Before the JSON: this envelope is the same in all versions, so that a reader can name the version that it refuses.
    check_version(path, version)
    header = _json_object(data[_FILE_HEAD.size : end])
    if header is None:
        raise damaged
    return header, end + _CRC.size


def _walk(data: mmap.mmap, place: int, row_bytes: int) -> _Findings:
    """Return valid blocks, lost parts and trailer of a ``.rigcap`` file, starting at byte `place`."""
    found = _Findings()
    while place < len(data):
        head = _block_head(data, place)
        if head is None:
            place = _skip(data, place, _next_head(data, place + 1), None, found)
            continue
        _count_missing(found, place, head.first_row)
        end = place + HEAD_BYTES + head.size + CRC_BYTES
        if end > len(data):
            place = _skip(data, place, _next_head(data, place + HEAD_BYTES), head, found)
        elif _take(data, place, end, head, row_bytes, found):
            place = end
            if head.magic == END_MAGIC:
                break
        else:
            place = _skip(data, place, end, head, found)
    if place < len(data):
        found.lost.append(Loss("bytes after the end", place, len(data) - place, found.next_row, 0))
    return found


def _take(data: mmap.mmap, place: int, end: int, head: BlockHead, row_bytes: int, found: _Findings) -> bool:
    end -= CRC_BYTES
    if zlib.crc32(memoryview(data)[place:end]) != _BLOCK_CRC.unpack_from(data, end)[0]:
        return False
    if head.magic == END_MAGIC:
        found.trailer = _json_object(data[place + HEAD_BYTES : end])
        return found.trailer is not None
    if head.size != head.rows * row_bytes or head.first_row < found.next_row:
        return False
    found.blocks.append((place + HEAD_BYTES, head.rows))
    found.next_row = head.first_row + head.rows
    return True


def _skip(data: mmap.mmap, place: int, resume: int, head: BlockHead | None, found: _Findings) -> int:
    whole = head is not None and place + HEAD_BYTES + head.size + CRC_BYTES <= len(data)
    reason = "damaged block" if whole or resume < len(data) else "torn tail"
    if head is None:
        found.lost.append(Loss(reason, place, resume - place, found.next_row, None))
    else:
        rows = max(0, head.first_row + head.rows - found.next_row)
        found.lost.append(Loss(reason, place, resume - place, found.next_row, rows))
        found.next_row += rows
    return resume


def _count_missing(found: _Findings, place: int, first_row: int) -> None:
    missing = max(0, first_row - found.next_row)
    if found.lost and found.lost[-1].rows is None:
        found.lost[-1] = replace(found.lost[-1], rows=missing)
    elif missing:
        found.lost.append(Loss("missing block", place, 0, found.next_row, missing))
    found.next_row += missing


def _block_head(data: mmap.mmap, place: int) -> BlockHead | None:
    """Return the head of the block at byte `place`; None if the bytes at this offset are not a valid head."""
    raw = data[place : place + HEAD_BYTES]
    if len(raw) < HEAD_BYTES:
        return None
    head = BlockHead(*_BLOCK_HEAD.unpack(raw))
    good = head.magic in (ROWS_MAGIC, END_MAGIC) and head.checksum == zlib.crc32(raw[:-8])
    return head if good and min(head.first_row, head.rows, head.size) >= 0 else None


def _next_head(data: mmap.mmap, place: int) -> int:
    """Return the byte offset of the next valid block head at or after `place`, or else the length of the file."""
    return next((place for place in _magics(data, place) if _block_head(data, place)), len(data))


def _magics(data: mmap.mmap, place: int) -> Iterator[int]:
    place = data.find(MAGIC[:4], place)
    while place >= 0:
        yield place
        place = data.find(MAGIC[:4], place + 1)


def _json_object(text: bytes) -> dict[str, Any] | None:
    try:
        value = parse_json(text)
    except ValueError:
        return None
    return value if isinstance(value, dict) else None
