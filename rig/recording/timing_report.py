"""Timing report of a recording: latency of each stage from the encoder sample to the applied effort.

`rig recording timing` prints the report and `rig.views` plots it. This module must not evaluate a run.
"""

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
    """Timing of a recording: times of each control tick, their summary, and the file's name (empty if in memory)."""

    ledger: Ledger
    summary: TimingSummary
    name: str = ""


def timing(recording: Recording | str | Path) -> TimingSummary:
    """Return quantiles of each latency stage (ns), the worst ticks and the loop's counters of a recording.

    Raise `RecordingError` if the recording (in memory, or the path of a file) cannot be read or has no rows, and
    `RigError` if the clock fit in its trailer is invalid.
    """
    return timing_of(recording).summary


def timing_of(recording: Recording | str | Path) -> Timing:
    """Return the times of each tick of a recording (ns), a summary of its latencies, and the file's name (or "").

    Raise `RecordingError` if the recording cannot be read or has no rows, and `RigError` if its clock fit is invalid.
    """
    name = ""
    if not isinstance(recording, Recording):
        name = Path(recording).name
        recording = open_recording(recording)
    ledger = ledger_of(recording)
    return Timing(ledger, summarise(ledger, (recording.trailer or {}).get("counters")), name)
