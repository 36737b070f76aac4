"""Open any recording, whatever its format; the first bytes decide, not the name."""

from __future__ import annotations

from pathlib import Path

from rig.core.errors import RecordingError
from rig.core.sample import COLUMNS
from rig.recording.capture import read_capture
from rig.recording.data import Recording
from rig.recording.files import plain_errors
from rig.recording.parquet import read_parquet
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
    with plain_errors("read", path), open(path, "rb") as file:
        magic = file.read(len(_PARQUET_MAGIC))
    recording = read_parquet(path) if magic == _PARQUET_MAGIC else read_capture(path)
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
