"""Open a recording file; its first bytes, not its name, decide whether it is Parquet or a ``.rigcap`` capture.

Commands, trials, `rig.experiments.lab`, the console, studies and plots use this module. It must not write, repair or
evaluate a file: the returned recording lists the damage (`Recording.lost`).
"""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from rig.core.errors import RecordingError
from rig.core.regular_file import open_regular
from rig.core.sample import COLUMNS
from rig.recording._capture import read_capture, read_capture_header
from rig.recording._parquet import read_parquet, read_parquet_facts
from rig.recording._shape import HEADER, TRAILER, misfit
from rig.recording.data import Recording
from rig.recording.files import plain_errors
from rig.recording.header import schema_of

_PARQUET_MAGIC = b"PAR1"


def open_recording(path: str | Path, columns: Collection[str] | None = None) -> Recording:
    """Read a recording file (Parquet or a ``.rigcap`` capture) into memory.

    Parameters
    ----------
    path
        Path of the file.
    columns
        Names of the columns to keep, to save memory; None: all. For one minute at 20 kHz, one column needs 10 MB and
        all columns 400 MB. Names that the recording lacks are ignored. The whole file is read and checked in any case.

    Raises
    ------
    RecordingError
        The file does not exist, is not a recording, has another format version or a damaged header, lacks a required
        column, or needs a library that is not installed. Damaged rows of a capture are no error: they are skipped and
        listed in `Recording.lost`.
    """
    path = Path(path)
    read = read_parquet if _is_parquet(path) else read_capture
    recording = _check(path, read(path, columns))
    if columns is None:
        return recording
    schema = schema_of(recording.header["schema"], columns)
    return replace(recording, header={**recording.header, "schema": schema})


def open_facts(path: str | Path) -> Recording:
    """Return header and trailer of a recording file as a recording without rows, from a few kilobytes of the file.

    A ``.rigcap`` capture gives only its header, because its trailer follows the rows. The checksum of the rows is not
    checked. Raise `RecordingError` if the file is missing, damaged or not a recording.
    """
    path = Path(path)
    return _check(path, read_parquet_facts(path) if _is_parquet(path) else read_capture_header(path))


def _is_parquet(path: Path) -> bool:
    with plain_errors("read", path), open_regular(path) as file:
        return file.read(len(_PARQUET_MAGIC)) == _PARQUET_MAGIC


def _check(path: Path, recording: Recording) -> Recording:
    missing = [column.name for column in COLUMNS if column.name not in recording.units]
    if missing:
        raise RecordingError(
            f"{path} has no column {missing[0]!r}, which every recording has",
            remedy="record again with haptic-rig",
        )
    wrong = misfit(recording.header, HEADER, "header")
    if not wrong and recording.trailer is not None:
        wrong = misfit(recording.trailer, TRAILER, "trailer")
    if wrong:
        raise RecordingError(f"{path} is invalid: {wrong}", remedy="record again with haptic-rig")
    return recording
