"""Sealing: conversion of a ``.rigcap`` capture, which survives a crash, to the Parquet file that is stored.

The capture is removed only after the Parquet file is on the disk, was read back and is equal bit by bit. If a crash
left both files, the next call compares them and finishes.

Trials, `rig recording recover`, maps, cuts and the console use this module. It must not remove a capture that it has
not compared.
"""

import logging
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import RecordingError
from rig.core.sample import TRUTH_COLUMNS
from rig.recording._capture import SUFFIX, write_capture
from rig.recording._ledger import with_ledger
from rig.recording._parquet import has_pyarrow, is_stored, write_parquet
from rig.recording.canonical import lossless
from rig.recording.data import Recording
from rig.recording.files import whole_file
from rig.recording.header import dtype_of, make_schema
from rig.recording.marks import with_sync_edges
from rig.recording.reader import open_facts, open_recording

__all__ = [
    "SEALED_SUFFIX",
    "SUFFIX",
    "seal",
    "with_truth",
]

SEALED_SUFFIX = ".parquet"

_log = logging.getLogger(__name__)


def seal(
    recording: Recording,
    truth: NDArray[np.void] | None = None,
    *,
    judge: Callable[[Recording], Mapping[str, Any]] | None = None,
    keep_capture: bool = False,
) -> Recording:
    """Convert a ``.rigcap`` capture to Parquet, add latencies and sync edges, and remove the capture.

    Return the recording read back from the new file. Without pyarrow, log a warning and keep the capture; if the
    capture is complete and undamaged, rewrite it with the added columns and the longer trailer. Raise `RecordingError`,
    without changing the capture, if `recording` is not a capture, the disk reports an error, another recording has the
    name, or the new file differs.

    Parameters
    ----------
    recording
        Recording read from a ``.rigcap`` file that is no longer being written. The times sampled_at and applied_at are
        filled into its rows in place, because a copy of a long recording would need much memory.
    truth
        True signals of the simulation (`rig.core.sample.TRUTH`), joined by sample index; NaN in rows without true
        signals.
    judge
        Function that receives the recording with the true signals, and returns keys to add to the trailer.
    keep_capture
        If True, do not remove the capture.
    """
    capture = recording.path
    assert capture is not None
    # A Parquet file would be compared with itself, and then removed as the capture.
    if capture.suffix == SEALED_SUFFIX:
        raise RecordingError(
            f"{capture} is not a capture: its suffix is that of a Parquet recording",
            remedy="give a .rigcap file",
        )
    names = recording.names
    sealed = recording if truth is None else with_truth(recording, truth)
    del recording, truth
    sealed = with_sync_edges(with_ledger(sealed))
    if judge is not None:
        sealed = replace(sealed, trailer={**(sealed.trailer or {}), **lossless(judge(sealed))})
    read_back = _ReadBack(sealed)
    if not has_pyarrow():
        _log.warning("pyarrow is not installed: %s stays a capture", capture)
        if not sealed.complete or sealed.lost:
            return open_recording(capture)
        with whole_file(capture, overwrite=True, check=read_back) as file:
            write_capture(file, sealed)
        return read_back.at(capture)
    target = capture.with_suffix(SEALED_SUFFIX)
    if target.exists():
        read_back = _ReadBack(sealed, names)
        read_back(target)
    else:
        with whole_file(target, check=read_back) as file:
            write_parquet(file, sealed)
    if not keep_capture:
        capture.unlink(missing_ok=True)
    return read_back.at(target)


def with_truth(recording: Recording, truth: NDArray[np.void]) -> Recording:
    """Return the recording with the true signals of its simulation as additional columns, matched by sample index.

    Rows without true signals get NaN; true signals without a row are ignored. If a sample index occurs twice in
    `truth`, the later one is used.
    """
    added = make_schema(TRUTH_COLUMNS, recording.header["motion"])
    schema = recording.header["schema"]
    before = schema["row_bytes"]
    moved = [{**column, "offset": column["offset"] + before} for column in added["columns"]]
    joined = {"row_bytes": before + added["row_bytes"], "columns": [*schema["columns"], *moved]}
    rows = np.empty(len(recording.rows), dtype_of(joined))
    _bytes_of(rows)[:, :before] = _bytes_of(recording.rows)
    wanted = recording.rows["sample_index"]
    order = np.argsort(truth["sample_index"], kind="stable")
    have = truth["sample_index"][order]
    place = np.searchsorted(have, wanted, side="right") - 1
    known = place >= 0
    known[known] = have[place[known]] == wanted[known]
    for column in TRUTH_COLUMNS:
        values = np.full(len(rows), np.nan)
        values[known] = truth[column.name][order[place[known]]]
        rows[column.name] = values
    return replace(recording, header={**recording.header, "schema": joined}, rows=rows)


def _bytes_of(rows: NDArray[np.void]) -> NDArray[np.uint8]:
    return rows.view(np.uint8).reshape(len(rows), rows.itemsize)


class _ReadBack:
    """Check that a written file equals the expected recording bit by bit; with `names`, only in these columns."""

    def __init__(self, expected: Recording, names: Collection[str] | None = None) -> None:
        self._expected = expected
        self._names = expected.names if names is None else names
        self._found = expected

    def __call__(self, path: Path) -> None:
        expected, names = self._expected, self._names
        found = open_facts(path) if has_pyarrow() else open_recording(path)
        same = (
            {**found.header, "schema": None} == {**expected.header, "schema": None}
            and (found.complete, found.lost) == (expected.complete, expected.lost)
            and (is_stored(path, expected, names) if has_pyarrow() else _same_bits(found.rows, expected.rows))
        )
        if not same:
            raise RecordingError(
                f"the recording in {path} differs from the capture {expected.path}",
                remedy="the capture was not removed; move one of the two files to another directory",
            )
        if found.names == expected.names:
            self._found = replace(found, rows=expected.rows)  # equal: not read a second time
        else:
            self._found = open_recording(path)

    def at(self, path: Path) -> Recording:
        """Return the recording that was read back, with `path` as the path of its file."""
        return replace(self._found, path=path)


def _same_bits(found: NDArray[np.void], expected: NDArray[np.void]) -> bool:
    return found.dtype == expected.dtype and np.array_equal(_bytes_of(found), _bytes_of(expected))
