"""Cut an interval out of a recording and store the interval as a recording of its own, with all columns at full rate.

The header of the cut names the source file with its SHA-256, the interval, and the time of cutting. The trailer only
states that the recording is a cut, not how the trial ended: a verdict needs the whole recording.

Only `rig.experiments.trials.cutting` uses this module; it adds the controller's state, so that the cut can be replayed.
The source recording must not be changed.
"""

from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from rig.core.errors import RecordingError
from rig.recording._capture import write_capture
from rig.recording._ledger import CLOCK_KEY
from rig.recording._parquet import has_pyarrow, write_parquet
from rig.recording.canonical import lossless
from rig.recording.data import Recording
from rig.recording.files import free_name, make_directories, sha256_of, whole_file
from rig.recording.origin import CUT, cut_facts
from rig.recording.seal import SEALED_SUFFIX


def cut(
    recording: Recording, first_s: float, last_s: float, initial_state: Mapping[str, Any] | None = None
) -> Recording:
    """Return the rows of a recording between two times as a new recording in memory.

    Raise `RecordingError` if the interval contains fewer than two rows, or ticks are missing inside it.

    Parameters
    ----------
    recording
        Whole recording, or an earlier cut.
    first_s, last_s
        Begin and end of the interval, counted from the first row of the recording (s); rows at these times are
        included.
    initial_state
        State of the controller before the first row of the cut, in the form of the header's key ``initial_state``.
        Without this state, the cut can be replayed only if it begins with the first row of the recording.
    """
    times, rows = recording.time_s, recording.rows
    first, end = np.searchsorted(times, first_s, "left"), np.searchsorted(times, last_s, "right")
    if end - first < 2:
        extent = f"rows from 0 to {times[-1]:.6g} s" if len(times) else "no rows"
        raise RecordingError(
            f"there are fewer than 2 rows between {first_s:.6g} and {last_s:.6g} s of the recording",
            remedy=f"choose a longer interval; the recording has {extent}",
        )
    taken = rows[first:end].copy()
    missing = int(taken["tick"][-1] - taken["tick"][0]) + 1 - len(taken)
    if missing:
        raise RecordingError(
            f"the recording has no rows for {missing} control ticks between {first_s:.6g} and {last_s:.6g} s",
            remedy="choose an interval before or after these missing ticks",
        )
    header, trailer = recording.header, recording.trailer or {}
    begins = {} if first else header["initial_state"]
    facts = {
        "recording": "" if recording.path is None else recording.path.name,
        "sha256": "" if recording.path is None else sha256_of(recording.path),
        "rows_before": int(first),
        "rows_after": len(rows) - int(end),
        "first_tick": int(taken["tick"][0]),
        "first_s": float(times[first]),
        "last_s": float(times[end - 1]),
        "cut_at": datetime.now(UTC).isoformat(timespec="milliseconds"),
    }
    kept = {key: trailer[key] for key in (CLOCK_KEY,) if key in trailer}
    sets = [one for one in trailer.get("parameter_sets") or [] if facts["first_tick"] <= one["tick"]]
    return replace(
        recording,
        header={
            **header,
            "initial_state": lossless(begins if initial_state is None else initial_state),
            "extra": {**header["extra"], CUT: facts},
        },
        rows=taken,
        trailer={"reason": CUT, "parameter_sets": sets, **kept},
        complete=True,
        lost=(),
        path=None,
    )


def write_cut(made: Recording, directory: Path) -> Path:
    """Write a cut (a part of a recording) as a new file in a directory and return the file's path.

    The file is named like the source recording, with ``-cut`` and a number if needed, and is Parquet if pyarrow is
    installed, otherwise a ``.rigcap`` capture. Raise `RecordingError` on a disk error.
    """
    make_directories(directory)
    of = Path((cut_facts(made) or {}).get("recording") or "recording").stem
    path = free_name(directory, f"{of}-cut")
    if has_pyarrow():
        path = path.with_suffix(SEALED_SUFFIX)
    with whole_file(path) as file:
        (write_parquet if has_pyarrow() else write_capture)(file, made)
    return path
