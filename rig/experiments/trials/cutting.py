"""Cut a part from a recording; the cut can be replayed with results equal to the last bit.

`rig.cut_recording` is defined here; the console calls it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.core.errors import RigError
from rig.experiments.trials.replay import state_before
from rig.recording.cutting import cut, write_cut
from rig.recording.reader import open_recording


@dataclass(frozen=True, slots=True, kw_only=True)
class CutResult:
    """A saved cut: a new recording with the samples of another recording between two times.

    Attributes
    ----------
    path
        Path of the cut's file.
    rows
        Number of samples in the cut.
    first_s, last_s
        Times of the first and the last sample of the cut, since the first one of the whole recording (s).
    no_replay
        Reason why the cut cannot be replayed; empty if a replay is possible.
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
    """Save the samples of a recording between two times as a new recording, and return its path and size.

    Parameters
    ----------
    recording
        Path of a sealed (compressed, checked) recording, or of a capture that no process writes any more.
    first_s, last_s
        Beginning and end of the cut, since the first sample of the recording (s).
    output
        Directory of the cut; None: the directory of the recording.
    zero_ns
        Device time from which `first_s` and `last_s` count, instead of the first sample (ns). A display that started
        during the run passes the time of the first sample that it received.

    Raises
    ------
    RecordingError
        The file is not a recording, fewer than two samples are between the two times, ticks are missing between them,
        or the file cannot be written.
    """
    whole = open_recording(recording)
    if zero_ns is not None and len(whole):
        shift_s = (zero_ns - int(whole.rows["device_time"][0])) * 1e-9
        first_s, last_s = first_s + shift_s, last_s + shift_s
    state, why = None, ""
    try:
        state = state_before(whole, int(np.searchsorted(whole.time_s, first_s, "left")))
    except RigError as error:  # save the rows also if they cannot be replayed
        why = str(error)
    made = cut(whole, first_s, last_s, state)
    path = write_cut(made, Path(recording).parent if output is None else Path(output))
    facts = made.header["extra"]["cut"]
    return CutResult(
        path=path, rows=len(made), first_s=facts["first_s"], last_s=facts["last_s"], no_replay=why
    )
