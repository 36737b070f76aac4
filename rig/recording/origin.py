"""Origin of a recording: a whole trial, a part cut out of a recording, or encoder counts of another logger.

Code that evaluates, replays or displays recordings uses this module, which reads only the header and never the rows. It
does not import the code that cuts and imports recordings (`rig.recording.cutting`, `rig.recording.counts`).
"""

from collections.abc import Mapping
from typing import Any

from rig.core.errors import RecordingError
from rig.recording.data import Recording

# Keys of the header's `extra`; the first is also the reason in the trailer of a cut.
CUT, COUNTS_FACTS = "cut", "counts"


def cut_facts(recording: Recording) -> Mapping[str, Any] | None:
    """Return source file, SHA-256 and interval (s) of a recording that was cut out of another; None if it is no cut."""
    found = recording.header["extra"].get(CUT)
    return found if isinstance(found, dict) else None


def counts_facts(recording: Recording) -> Mapping[str, Any] | None:
    """Return file, rate (Hz), resolution and lost samples of counts imported from CSV; None for other recordings."""
    found = (recording.header.get("extra") or {}).get(COUNTS_FACTS)
    return found if isinstance(found, dict) else None


def refuse_counts(recording: Recording) -> None:
    """Raise `RecordingError` if the recording was imported from CSV: it then describes no rig, control law and wall."""
    if (facts := counts_facts(recording)) is not None:
        raise RecordingError(
            f"the recording was imported from {facts['file']}: it has encoder counts, but no rig, control law and wall",
            remedy="use it with `rig show`, `rig recording export`, `rig estimators compare` and `rig estimators tune`",
        )
