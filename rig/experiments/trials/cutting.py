"""Cut a recording so that the cut replays to the last bit, as the whole does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.core.errors import RigError
from rig.experiments.trials.replay import state_before
from rig.recording.cutting import cut, write_cut
from rig.recording.reader import open_recording


@dataclass(frozen=True, slots=True, kw_only=True)
class CutResult:
    """A cut that was saved.

    Attributes
    ----------
    path
        Its file.
    rows
        That it has.
    first_s, last_s
        Times of its first and its last row, since the first row of the recording that it was cut from (s).
    no_replay
        Why it cannot be replayed; empty where it can.
    """

    path: Path
    rows: int
    first_s: float
    last_s: float
    no_replay: str = ""


def cut_recording(
    recording: str | Path,
    first_s: float,
    last_s: float,
    *,
    output: str | Path | None = None,
    zero_ns: int | None = None,
) -> CutResult:
    """Save what a recording has between two times as a recording of its own.

    Parameters
    ----------
    recording
        A capture that is not being written any more, or a sealed recording.
    first_s, last_s
        From and up to when, since its first row (s).
    output
        Directory of the cut, unless that of the recording.
    zero_ns
        Device time that the seconds count from instead of the first row (ns): who looked on saw another one first.

    Raises
    ------
    RecordingError
        The file is no recording, there are no two rows between these times, ticks are lost between them, or the disk
        refuses.
    """
    whole = open_recording(recording)
    if zero_ns is not None and len(whole):
        shift_s = (zero_ns - int(whole.rows["device_time"][0])) * 1e-9
        first_s, last_s = first_s + shift_s, last_s + shift_s
    state, why = None, ""
    try:
        state = state_before(whole, int(np.searchsorted(whole.time_s, first_s, "left")))
    except RigError as error:  # its rows are worth a file all the same
        why = str(error)
    made = cut(whole, first_s, last_s, state)
    path = write_cut(made, Path(recording).parent if output is None else Path(output))
    facts = made.header["extra"]["cut"]
    return CutResult(
        path=path, rows=len(made), first_s=facts["first_s"], last_s=facts["last_s"], no_replay=why
    )
