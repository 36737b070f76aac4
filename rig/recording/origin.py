"""What kind of recording one is, by its header: of a whole trial, a cut of one, or counts of another logger.

Who judges, replays or shows a recording calls it, without what cuts and imports (`rig.recording.cutting`, `counts`).

It must not read a row: the header alone decides.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rig.core.errors import RecordingError
from rig.recording.data import Recording

# Keys of the header's `extra`; the first is also the reason in the trailer of a cut.
CUT, COUNTS_FACTS = "cut", "counts"


def cut_facts(recording: Recording) -> Mapping[str, Any] | None:
    """Return the source and interval of a cut, from its header; None for a whole recording."""
    found = recording.header["extra"].get(CUT)
    return found if isinstance(found, dict) else None


def counts_facts(recording: Recording) -> Mapping[str, Any] | None:
    """Return what is known of imported counts (rate, resolution, lost samples); None for other recordings."""
    found = (recording.header.get("extra") or {}).get(COUNTS_FACTS)
    return found if isinstance(found, dict) else None


def refuse_counts(recording: Recording) -> None:
    """Raise `RecordingError` for a recording that has no rig, law and wall."""
    if (facts := counts_facts(recording)) is not None:
        raise RecordingError(
            f"the recording has only counts of {facts['file']}, without a rig and a wall",
            remedy="use it with `rig show`, `rig recording export`, `rig estimators compare` and `rig estimators tune`",
        )
