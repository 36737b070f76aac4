"""Open any recording, whatever its format; the first bytes decide, not the name."""

from __future__ import annotations

from pathlib import Path

from rig.core.errors import RecordingError
from rig.core.sample import COLUMNS
from rig.recording.capture import read_capture, read_capture_header
from rig.recording.data import Recording
from rig.recording.files import plain_errors
from rig.recording.parquet import read_parquet, read_parquet_facts
from rig.recording.shape import HEADER, TRAILER, misfit

_PARQUET_MAGIC = b"PAR1"


def open_recording(path: str | Path) -> Recording:
    """Read a capture or a sealed recording into memory.

    Raises
    ------
    RecordingError
        There is no such file, it is no recording, it is of another format version, its header is damaged, it lacks a
        column, or it needs a library that is not installed. Damage after the header is no error: see `Recording.lost`
        and `Recording.complete`.
    """
    path = Path(path)
    return _checked(path, read_parquet(path) if _is_parquet(path) else read_capture(path))


def open_facts(path: str | Path) -> Recording:
    """A recording without its rows: header and trailer, from a few kilobytes of the file.

    A capture has its header alone: how it ended stands behind its rows. What a checksum would say is not known. Errors
    as `open_recording`.
    """
    path = Path(path)
    return _checked(path, read_parquet_facts(path) if _is_parquet(path) else read_capture_header(path))


def _is_parquet(path: Path) -> bool:
    with plain_errors("read", path), open(path, "rb") as file:
        return file.read(len(_PARQUET_MAGIC)) == _PARQUET_MAGIC


def _checked(path: Path, recording: Recording) -> Recording:
    missing = [column.name for column in COLUMNS if column.name not in recording.names]
    if missing:
        raise RecordingError(
            f"{path} has no column {missing[0]!r}, which every recording has",
            remedy="record again with `rig`",
        )
    wrong = misfit(recording.header, HEADER, "header")
    if not wrong and recording.trailer is not None:
        wrong = misfit(recording.trailer, TRAILER, "trailer")
    if wrong:
        raise RecordingError(f"{path} is invalid: {wrong}", remedy="record again with `rig`")
    return recording
