"""Timing of a recording: the summary of its latency ledger.

`rig recording timing` prints it and `rig.views` plots it. It must not judge a run.
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
    """Latency ledger of a recording, its summary, and the name of the file (empty for a recording in memory)."""

    ledger: Ledger
    summary: TimingSummary
    name: str = ""


def timing(recording: Recording | str | Path) -> TimingSummary:
    """Return the summary of the latency ledger of a recording, sealed or still a capture.

    Raises
    ------
    RecordingError
        The recording cannot be read, lacks a column of the ledger, or has no rows.
    RigError
        The clock in its trailer is invalid.
    """
    return timing_of(recording).summary


def timing_of(recording: Recording | str | Path) -> Timing:
    """Return latency ledger and summary of a recording, for a plot; parameters and errors as `timing`."""
    name = ""
    if not isinstance(recording, Recording):
        name = Path(recording).name
        recording = open_recording(recording)
    ledger = ledger_of(recording)
    return Timing(ledger, summarise(ledger, (recording.trailer or {}).get("counters")), name)
