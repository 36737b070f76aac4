"""Tolerated events of real-time tests on a busy machine; they are counted, and printed at the end of the run.

A run that lost its link because the machine was too busy is safe and recorded, but proves nothing else. The test
records that here instead of passing silently, and the summary shows how often this happened.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING, NoReturn

import numpy as np
import pytest

from rig.core.sample import phase_name

if TYPE_CHECKING:
    from rig.recording.data import Recording

PROPERTY = "tolerated"  # in the properties of a test's report
_in_this_test: list[str] = []


def tolerated(what: object) -> None:
    """Record that the running test tolerates an error or an event that a sentence describes."""
    _in_this_test.append(f"{type(what).__name__}: {what}" if isinstance(what, Exception) else str(what))


def too_busy(what: object) -> NoReturn:
    """Skip the running test, because the machine was too busy for it to begin."""
    tolerated(what)
    pytest.skip(f"too busy: {what}")


def reason_of(recording: Recording) -> str:
    """Return why a real-time run ended; skip the test if it lost its device, which any busy machine can cause."""
    reason = str(recording.trailer["reason"])
    if reason in ("link_silent", "device_fault"):
        too_busy(f"{recording.trailer['error']}; {_place_of_the_loss(recording)}")
    return reason


def _place_of_the_loss(recording: Recording) -> str:
    """Return a text: where in the run the device was lost, and the longest gap between samples."""
    rows = recording.rows
    if len(rows) < 2:
        return f"after {len(rows)} rows"
    phase, apart_ms = phase_name(int(rows["phase"][-1])), np.diff(rows["device_time"]) / 1e6
    longest = int(apart_ms.argmax())
    return f"after {len(rows)} rows, in {phase}; at most {apart_ms[longest]:.1f} ms apart, at row {longest}"


def taken() -> list[tuple[str, str]]:
    """Return and clear what was recorded since the last call, as properties of a report."""
    found = [(PROPERTY, what) for what in _in_this_test]
    _in_this_test.clear()
    return found


def summary(reports: Iterable[pytest.TestReport]) -> list[str]:
    """Return a line for each test that tolerated something, most frequent first."""
    counts = Counter(
        (report.nodeid.partition("[")[0], what.partition(";")[0])
        for report in reports
        for name, what in report.user_properties
        if name == PROPERTY
    )
    return [f"{number} × {test}: {what}" for (test, what), number in counts.most_common()]
