"""Recordings for other programs.

CSV is for anything, X-Y is force over penetration, Parquet for data frames, MAT for MATLAB and Octave, MCAP for
Foxglove and PlotJuggler.

`rig recording export`, `rig recording import`, the console and studies call it. It must not change the recording, and
overwrites a file only when asked to.
"""

from __future__ import annotations

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
    """Write a recording for another program.

    Parameters
    ----------
    recording
        A recording, or its path.
    path
        The file to write; CSV also writes its sidecar beside it (see `sidecar_of`).
    format
        One of `EXPORTERS`; without it the suffix of `path` decides.
    overwrite
        Replace files of that name.

    Raises
    ------
    RecordingError
        Unknown format, a file in the way, a disk that refuses, a recording that cannot be read or is too
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
    """Name of the JSON file beside a CSV that describes its columns."""
    return path.with_name(path.name + ".json")


def facts(recording: Recording) -> dict[str, object]:
    """Return everything about a recording but its rows."""
    return {
        "header": recording.header,
        "trailer": recording.trailer,
        "complete": recording.complete,
        "lost": [asdict(loss) for loss in recording.lost],
        "units": recording.units,
        "descriptions": recording.descriptions,
    }


def write_sidecar(file: BinaryIO, recording: Recording) -> None:
    """JSON object with header, trailer, completeness, losses, units and descriptions."""
    file.write(canonical_json(facts(recording)) + b"\n")


def write_csv(file: BinaryIO, recording: Recording) -> None:
    """One line of column names, one line a row; floats with the shortest digits that read back equal."""
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(recording.names)
    for first in range(0, len(recording), _ROWS_AT_ONCE):
        writer.writerows(recording.rows[first : first + _ROWS_AT_ONCE].tolist())
    text.detach()


def write_xy(file: BinaryIO, recording: Recording) -> None:
    """Force of the wall over penetration: a CSV of two columns, units in their names, for the trial proper."""
    trial = recording.rows["phase"] == Phase.TRIAL
    names = ("penetration", "effort_wall")
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([f"{name} ({recording.units[name]})" for name in names])
    writer.writerows(zip(*(recording.rows[name][trial].tolist() for name in names), strict=True))
    text.detach()


def write_mat(file: BinaryIO, recording: Recording) -> None:
    """MATLAB 5 file: structs ``data`` (column vectors), ``units``, ``descriptions``; the rest as JSON text.

    ``jsondecode(header)`` gives the header as a struct. Whole numbers stay int64.
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
        raise RecordingError(f"MAT cannot hold this recording: {error}", remedy="export Parquet") from error


EXPORTERS: Mapping[str, Callable[[BinaryIO, Recording], None]] = {
    "csv": write_csv,
    "xy": write_xy,
    "parquet": write_parquet,
    "mat": write_mat,
    "mcap": write_mcap,
}
