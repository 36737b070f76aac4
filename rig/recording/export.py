"""Export of recordings as CSV, X-Y (a CSV of force over penetration), Parquet, MAT and MCAP.

MAT is for MATLAB and Octave, MCAP for Foxglove and PlotJuggler. `rig recording export`, `rig recording import`, the
console and studies use this module. It must not change the recording, and overwrites a file only with `overwrite`.
"""

import csv
import io
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import BinaryIO

import numpy as np

from rig.core.deferred import io as scipy_io
from rig.core.errors import RecordingError
from rig.core.sample import Phase
from rig.recording._mcap import write_mcap
from rig.recording._parquet import write_parquet
from rig.recording.canonical import canonical_json
from rig.recording.data import Recording
from rig.recording.files import refuse_existing, whole_file
from rig.recording.reader import open_recording

_ROWS_AT_ONCE = 10_000


def export(
    recording: Recording | str | Path, path: str | Path, format: str | None = None, *, overwrite: bool = False
) -> Path:
    """Write a recording as a file for another program, and return the path of that file.

    Parameters
    ----------
    recording
        A recording in memory, or the path of its file.
    path
        Path of the file to write. For CSV, a JSON file that describes the columns is written beside it (`sidecar_of`).
    format
        One of the keys of `EXPORTERS`: "csv", "xy", "parquet", "mat" or "mcap". Default: the suffix of `path`.
    overwrite
        If True, replace an existing file.

    Raises
    ------
    RecordingError
        The format is unknown, the file exists, the disk reports an error, or the recording cannot be read or is too
        large for the format.
    """
    path = Path(path)
    name = format or path.suffix.removeprefix(".").lower()
    if name not in EXPORTERS:
        raise RecordingError(
            f"unknown export format {name!r}", remedy=f"the formats are {', '.join(EXPORTERS)}"
        )
    if not isinstance(recording, Recording):
        recording = open_recording(recording)
    if name == "csv":
        if not overwrite:
            refuse_existing(path)
        with whole_file(sidecar_of(path), overwrite=overwrite) as file:
            write_sidecar(file, recording)
    with whole_file(path, overwrite=overwrite) as file:
        EXPORTERS[name](file, recording)
    return path


def sidecar_of(path: Path) -> Path:
    """Return the path of the JSON file that describes the columns of a CSV file: the CSV file's name plus ``.json``."""
    return path.with_name(path.name + ".json")


def facts(recording: Recording) -> dict[str, object]:
    """Return all of a recording but its rows, for JSON: header, trailer, lost parts, units and meanings of columns."""
    return {
        "header": recording.header,
        "trailer": recording.trailer,
        "complete": recording.complete,
        "lost": [asdict(loss) for loss in recording.lost],
        "units": recording.units,
        "descriptions": recording.descriptions,
    }


def write_sidecar(file: BinaryIO, recording: Recording) -> None:
    """Write all of a recording but its rows as one JSON object: header, trailer, lost parts, units and meanings."""
    file.write(canonical_json(facts(recording)) + b"\n")


def write_csv(file: BinaryIO, recording: Recording) -> None:
    """Write a recording as CSV: a line of column names, then one line per row; floats can be read back without loss."""
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(recording.names)
    for first in range(0, len(recording), _ROWS_AT_ONCE):
        writer.writerows(recording.rows[first : first + _ROWS_AT_ONCE].tolist())
    text.detach()


def write_xy(file: BinaryIO, recording: Recording) -> None:
    """Write a CSV of penetration and wall effort while the trial ran; the column names contain the units."""
    trial = recording.rows["phase"] == Phase.TRIAL
    names = ("penetration", "effort_wall")
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([f"{name} ({recording.units[name]})" for name in names])
    writer.writerows(zip(*(recording.rows[name][trial].tolist() for name in names), strict=True))
    text.detach()


def write_mat(file: BinaryIO, recording: Recording) -> None:
    """Write a recording as a MATLAB 5 file with the structs ``data``, ``units`` and ``descriptions``.

    ``data`` has one column vector per column of the recording; integers are stored as int64. Header, trailer and losses
    are JSON text: ``jsondecode(header)`` returns a struct.
    """
    parts = facts(recording)
    texts = {name: canonical_json(parts[name]).decode() for name in ("header", "trailer", "lost")}
    contents = {
        "data": recording.to_numpy(),
        "units": recording.units,
        "descriptions": recording.descriptions,
        "complete": np.bool_(recording.complete),
        **texts,
    }
    try:
        scipy_io.savemat(file, contents, long_field_names=True, do_compression=True, oned_as="column")
    except ValueError as error:
        raise RecordingError(
            f"a MATLAB 5 file cannot store this recording: {error}",
            remedy="export the recording as parquet, which has no such limit",
        ) from error


EXPORTERS: Mapping[str, Callable[[BinaryIO, Recording], None]] = {
    "csv": write_csv,
    "xy": write_xy,
    "parquet": write_parquet,
    "mat": write_mat,
    "mcap": write_mcap,
}
