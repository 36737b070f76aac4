"""Timing of a recording: the summary of its latency ledger.

`rig recording timing` shows it and `rig.views` draws it. It must not judge a run.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rig.core.shown import Drawn
from rig.recording._ledger import ledger_of
from rig.recording._timing_summary import TimingSummary, summarise
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from rig.recording.timing import LATENESS, STAGES, Ledger

__all__ = ["LATENESS", "STAGES", "Ledger", "Timing", "TimingSummary", "timing", "timing_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Timing(Drawn):
    """The ledger of a recording and its summary; `name` is that of its file, empty without one."""

    ledger: Ledger
    summary: TimingSummary
    name: str = ""


def timing(recording: Recording | str | Path) -> TimingSummary:
    """Add up the latency ledger of a recording, sealed or still a capture.

    Raises
    ------
    RecordingError
        It cannot be read, lacks a column of the ledger, or has no rows.
    RigError
        The clock in its trailer makes no sense.
    """
    return timing_of(recording).summary


def timing_of(recording: Recording | str | Path) -> Timing:
    """Return the ledger too, for a picture; parameters and errors as `timing`."""
    name = ""
    if not isinstance(recording, Recording):
        name = Path(recording).name
        recording = open_recording(recording)
    ledger = ledger_of(recording)
    return Timing(ledger, summarise(ledger, (recording.trailer or {}).get("counters")), name)
