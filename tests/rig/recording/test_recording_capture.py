"""The capture format byte by byte: readable from its description alone, and every kind of damage is reported."""

import json
import struct
import sys
import zlib
from io import BytesIO
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from rig.core.errors import RecordingError
from rig.core.sample import COLUMNS, ROW
from rig.realtime.scheduling import _memory as memory
from rig.recording._capture import (
    CRC_BYTES,
    HEAD_BYTES,
    ROWS_MAGIC,
    pack_block,
    pack_end,
    pack_header,
    read_capture,
    write_capture,
)
from rig.recording.data import Loss, Recording
from rig.recording.header import VERSION
from rig.recording.reader import open_recording
from tests.conformance.damaged import each_damaged
from tests.conformance.recording import example_header, example_rows

HEADER = example_header()
BLOCK_ROWS = 4
BLOCK_BYTES = HEAD_BYTES + BLOCK_ROWS * ROW.itemsize + CRC_BYTES


def capture_bytes(rows: NDArray[np.void], *, complete: bool = True) -> bytes:
    file = BytesIO()
    write_capture(file, Recording(HEADER, rows, {"reason": "finished"}, complete), block_rows=BLOCK_ROWS)
    return file.getvalue()


def read_bytes(path: Path, data: bytes) -> Recording:
    path.write_bytes(data)
    return open_recording(path)


def start_of(block: int) -> int:
    return len(pack_header(HEADER)) + block * BLOCK_BYTES


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "trial.rigcap"


def test_a_reader_needs_only_the_description() -> None:
    """Reads the format with struct, json and zlib, line by line after the table in the module's docstring."""
    rows = example_rows(10)
    data = capture_bytes(rows)
    assert data[:8] == b"\x89RIGCAP\n"
    version, length = struct.unpack("<II", data[8:16])
    header = json.loads(data[16 : 16 + length])
    (crc,) = struct.unpack("<I", data[16 + length : 20 + length])
    assert (version, crc) == (VERSION, zlib.crc32(data[: 16 + length]))
    assert header == HEADER
    place = 20 + length
    taken = b""
    blocks = []
    while True:
        assert place % 8 == 0
        magic, number, first, count, size, head_crc = struct.unpack("<8s5q", data[place : place + 48])
        assert head_crc == zlib.crc32(data[place : place + 40])
        (block_crc,) = struct.unpack("<q", data[place + 48 + size : place + 56 + size])
        assert block_crc == zlib.crc32(data[place : place + 48 + size])
        payload = data[place + 48 : place + 48 + size]
        place += 56 + size
        blocks.append((number, first, count))
        if magic == b"\x89RIGEND\n":
            break
        assert magic == b"\x89RIGROWS"
        taken += payload
    assert blocks == [(0, 0, 4), (1, 4, 4), (2, 8, 2), (3, 10, 0)]
    assert json.loads(payload) == {"reason": "finished"}
    assert place == len(data)
    assert len(taken) == 10 * header["schema"]["row_bytes"]
    for column in header["schema"]["columns"]:
        values = [
            np.frombuffer(taken, column["dtype"], 1, row * header["schema"]["row_bytes"] + column["offset"])
            for row in range(10)
        ]
        assert np.concatenate(values).tobytes() == rows[column["name"]].tobytes()


@given(tail=st.binary(max_size=300), cut=st.integers(0, 2 * BLOCK_BYTES))
def test_bytes_after_a_header_are_rows_or_counted_losses(
    tmp_path_factory: pytest.TempPathFactory, tail: bytes, cut: int
) -> None:
    """After a valid header, whole blocks are read, and every other byte counts as lost."""
    path = tmp_path_factory.getbasetemp() / "tail.rigcap"
    blocks = capture_bytes(example_rows(2 * BLOCK_ROWS), complete=False)[len(pack_header(HEADER)) :][:cut]
    data = pack_header(HEADER) + blocks + tail
    path.write_bytes(data)
    found = open_recording(path)
    assert len(found) >= cut // BLOCK_BYTES * BLOCK_ROWS
    used = len(found) // BLOCK_ROWS * BLOCK_BYTES
    assert used + sum(loss.size for loss in found.lost) == len(data) - len(pack_header(HEADER))


@given(
    data=st.binary(max_size=100),
    start=st.sampled_from([b"", b"PAR1", b"\x89RIGCAP\n", b"\x89RIGCAP\n\x01\0\0\0"]),
)
def test_any_file_gives_a_recording_error(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, start: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "garbage"
    path.write_bytes(start + data)
    with pytest.raises(RecordingError):
        open_recording(path)


def test_a_block_torn_at_any_byte_loses_that_block_only(path: Path) -> None:
    """Cut at every byte of head and checksum, and at some bytes of the rows between, which are alike."""
    rows = example_rows(3 * BLOCK_ROWS)
    whole = capture_bytes(rows, complete=False)
    start, end = start_of(2), start_of(3)
    first, last = start + HEAD_BYTES + 8, end - CRC_BYTES
    for size in (*range(start + 1, first), *range(first, last, 301), *range(last, end)):
        found = read_bytes(path, whole[:size])
        assert found.rows.tobytes() == rows[: 2 * BLOCK_ROWS].tobytes()
        assert not found.complete
        (loss,) = found.lost
        known = BLOCK_ROWS if size - start_of(2) >= HEAD_BYTES else None
        assert loss == Loss("torn tail", start_of(2), size - start_of(2), 2 * BLOCK_ROWS, known)


def test_damaged_head_costs_only_its_block(path: Path) -> None:
    """A damaged length is never used, because the head has its own checksum."""
    rows, start = example_rows(3 * BLOCK_ROWS), start_of(1)
    path.write_bytes(capture_bytes(rows))
    for place in each_damaged(path, range(start, start + HEAD_BYTES), repeat(0x40)):
        found = open_recording(path)
        assert found.rows.tobytes() == rows[:4].tobytes() + rows[8:].tobytes(), place
        assert found.lost == (Loss("damaged block", start, BLOCK_BYTES, 4, 4),), place
        assert found.complete


def test_a_damaged_row_costs_its_block(path: Path) -> None:
    path.write_bytes(capture_bytes(example_rows(3 * BLOCK_ROWS)))
    for block, start in enumerate(map(start_of, range(3))):
        places = [start + place for place in (HEAD_BYTES, HEAD_BYTES + 100, BLOCK_BYTES - 8, BLOCK_BYTES - 1)]
        for _ in each_damaged(path, places, repeat(1)):
            found = open_recording(path)
            assert found.lost == (Loss("damaged block", start, BLOCK_BYTES, 4 * block, 4),)
            assert str(found.lost[0]).startswith(f"damaged block: rows {4 * block} to {4 * block + 3} (")
            assert len(found) == 8


def test_damaged_end_differs_from_a_missing_end(path: Path) -> None:
    data = bytearray(capture_bytes(example_rows(4)))
    data[-20] ^= 1
    found = read_bytes(path, bytes(data))
    assert len(found) == 4
    assert not found.complete
    assert [(loss.reason, loss.rows) for loss in found.lost] == [("damaged block", 0)]


def test_a_block_that_was_cut_out_is_missed(path: Path) -> None:
    data = capture_bytes(example_rows(3 * BLOCK_ROWS))
    found = read_bytes(path, data[: start_of(1)] + data[start_of(2) :])
    assert found.lost == (Loss("missing block", start_of(1), 0, 4, 4),)
    found = read_bytes(path, data[: start_of(2)] + data[start_of(3) :])
    assert found.lost == (Loss("missing block", start_of(2), 0, 8, 4),)


def test_a_block_that_is_there_twice_is_used_once(path: Path) -> None:
    data = capture_bytes(example_rows(2 * BLOCK_ROWS))
    found = read_bytes(path, data[: start_of(1)] + data[start_of(0) :])
    assert len(found) == 8
    assert [(loss.offset, loss.rows) for loss in found.lost] == [(start_of(1), 0)]


def test_bytes_after_the_end_are_reported(path: Path) -> None:
    found = read_bytes(path, capture_bytes(example_rows(4)) + b"more")
    assert found.complete
    assert [(loss.reason, loss.size) for loss in found.lost] == [("bytes after the end", 4)]


def test_rows_that_contain_the_magic_of_a_block_do_not_mislead(path: Path) -> None:
    rows = example_rows(2 * BLOCK_ROWS)
    rows["tick"][:4] = int.from_bytes(ROWS_MAGIC, "little")
    data = bytearray(capture_bytes(rows))
    data[start_of(0)] ^= 1
    found = read_bytes(path, bytes(data))
    assert found.rows.tobytes() == rows[4:].tobytes()
    assert found.lost == (Loss("damaged block", start_of(0), BLOCK_BYTES, 0, 4),)


def test_rows_of_the_wrong_size_are_not_taken(path: Path) -> None:
    """A valid checksum over a row count that contradicts the schema is an error of the writer, not of the disk."""
    data = pack_header(HEADER) + pack_block(ROWS_MAGIC, 0, 0, 3, bytes(2 * ROW.itemsize)) + pack_end(1, 3, {})
    found = read_bytes(path, data)
    assert (len(found), found.lost[0].rows) == (0, 3)


def test_a_damaged_header_is_an_error(path: Path) -> None:
    size = len(pack_header(HEADER))
    path.write_bytes(capture_bytes(example_rows(4)))
    for _ in each_damaged(path, [*range(8, 40), size - 4, size - 1], repeat(0x10)):
        with pytest.raises(RecordingError, match=r"header of .* is damaged"):
            open_recording(path)


@pytest.mark.parametrize("other", [VERSION - 1, VERSION + 1])
def test_another_format_version_is_refused(path: Path, other: int) -> None:
    data = bytearray(pack_header(HEADER)[:-4])
    data[8] = other
    with pytest.raises(RecordingError, match=f"format version {other}, .* reads version {VERSION}"):
        read_bytes(path, bytes(data) + struct.pack("<I", zlib.crc32(data)))


def schema_of(row_bytes: int, dtype: str, offset: int) -> dict[str, Any]:
    column = {"name": "a", "dtype": dtype, "offset": offset, "unit": "1", "description": ""}
    return {"row_bytes": row_bytes, "columns": [column]}


@pytest.mark.parametrize(
    "schema",
    [
        None,
        {},
        {"row_bytes": 8, "columns": []},
        {"row_bytes": 8, "columns": [{"name": "a", "dtype": "<i8", "offset": 0}]},
        schema_of(8, "O", 0),
        schema_of(4, "<i8", 0),
        schema_of(8, "<i8", -8),
    ],
)
def test_a_schema_without_sense_is_an_error(path: Path, schema: Any) -> None:
    with pytest.raises(RecordingError, match="schema"):
        read_bytes(path, pack_header({**HEADER, "schema": schema}))


def test_files_that_are_no_recordings(tmp_path: Path) -> None:
    empty, text = tmp_path / "empty.rigcap", tmp_path / "text.rigcap"
    empty.touch()
    text.write_text("time,position\n")
    for place, message in (
        (empty, "is empty"),
        (text, "is not a recording"),
        (tmp_path, "Is a directory"),
        (tmp_path / "absent", "No such file"),
    ):
        with pytest.raises(RecordingError, match=message) as caught:
            open_recording(place)
        assert str(place) in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(RecordingError, match="is empty"):
        read_capture(empty)


def test_recording_with_losses_is_not_written_as_whole() -> None:
    damaged = Recording(HEADER, example_rows(2), {}, True, (Loss("torn tail", 0, 9, 2, None),))
    with pytest.raises(RecordingError, match="with lost parts"):
        write_capture(BytesIO(), damaged)


def test_columns_are_reached_by_name(path: Path) -> None:
    rows = example_rows(6)
    rows["device_time"] = 1_000_000_000 + np.arange(6) * 50_000
    found = read_bytes(path, capture_bytes(rows))
    assert found.names == tuple(column.name for column in COLUMNS)
    assert found.column("count").flags.c_contiguous
    assert found.to_numpy()["count"].tobytes() == rows["count"].tobytes()
    assert found.time_s == pytest.approx(np.arange(6) * 50e-6)
    assert found.experiment["wall"]["stiffness"] == 560.0
    assert not found.has_truth
    with pytest.raises(RecordingError, match=r"no column 'torque'; its columns are tick, sample_index"):
        found.column("torque")


def test_time_comes_from_the_host_where_the_device_has_no_clock(path: Path) -> None:
    rows = example_rows(3)
    rows["device_time"] = 0
    rows["received_at"] = [7, 1_000_000_007, 2_000_000_007]
    assert read_bytes(path, capture_bytes(rows)).time_s.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.skipif(sys.platform != "linux", reason="memory is locked on Linux alone")
def test_a_capture_is_read_while_the_memory_of_the_process_is_locked(path: Path) -> None:
    """Memory is locked while another thread runs in real time, and locked pages cannot be dropped."""
    rows = example_rows(10)
    refusal = memory.take()
    if refusal is not None:
        pytest.skip(refusal.text)
    try:
        assert len(read_bytes(path, capture_bytes(rows))) == len(rows)
    finally:
        memory.give_back()
