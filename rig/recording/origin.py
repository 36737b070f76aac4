"""Origin of a recording, from its header: a whole trial, a cut of a recording, or counts of another logger.

Code that judges, replays or shows recordings calls it; this file does not import the code that cuts and imports them
(`rig.recording.cutting`, `counts`).

It must not read rows: the header alone decides.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rig.core.errors import RecordingError
from rig.recording.data import Recording

# Keys of the header's `extra`; the first is also the reason in the trailer of a cut.
CUT, COUNTS_FACTS = "cut", "counts"


def cut_facts(recording: Recording) -> Mapping[str, Any] | None:
    """Return the header's facts about source and interval if the recording was cut out of another, otherwise None."""
    found = recording.header["extra"].get(CUT)
    return found if isinstance(found, dict) else None


def counts_facts(recording: Recording) -> Mapping[str, Any] | None:
    """Return rate, resolution and lost samples of imported counts; None if the recording is not an import."""
    found = (recording.header.get("extra") or {}).get(COUNTS_FACTS)
    return found if isinstance(found, dict) else None


def refuse_counts(recording: Recording) -> None:
    """Raise `RecordingError` for imported counts, which have no rig, law and wall."""
    if (facts := counts_facts(recording)) is not None:
        raise RecordingError(
            f"the recording has only counts of {facts['file']}, without a rig and a wall",
            remedy="use it with `rig show`, `rig recording export`, `rig estimators compare` and `rig estimators tune`",
        )
