"""Select the values of a trial that are exported beside its recording, and their names in files."""

import re
from collections.abc import Mapping
from typing import Any

from rig.core.quantity import Quantity, quantities
from rig.extras.study.rows import TrialRow

# Name in a file: field. A run is something else in BIDS.
_FIELDS = {
    "trial": "trial",
    "block": "block",
    "search_run": "run",
    **{name: name for name in ("repeat", "attempt", "condition", "damping", "stiffness", "track", "catch")},
    **{name: name for name in ("practice", "counts", "void", "ended", "automatic", "verdict", "judged_by")},
    "response_time": "response_time_s",
    "too_fast": "too_fast",
    "sha256": "sha256",
}
_COUNTS = Quantity("", "1 if the trial counts; 0 for practice and for the reasons in void")
FACTS: Mapping[str, Quantity] = {
    name: {**quantities(TrialRow), "counts": _COUNTS}[field] for name, field in _FIELDS.items()
}


def facts_of(row: TrialRow) -> dict[str, Any]:
    """Return the exported values of one trial, by their names in files (`FACTS`)."""
    return {name: getattr(row, field) for name, field in _FIELDS.items()}


def unusable(row: TrialRow) -> str | None:
    """Return why a trial's recording must not be exported, as a sentence; None if it may be exported."""
    if row.recorded in {"missing", "changed"}:
        return f"{row.participant}, trial {row.trial}: its recording is {row.recorded}"
    return None


def file_name(code: str) -> str:
    """Return a participant's code as a file name, without characters that have a meaning in paths."""
    return re.sub(r"[^\w.+-]", "-", code).lstrip(".") or "-"
