"""What real-time tests tolerate on a busy machine: counted, and printed at the end of the run.

A run that lost its link because the machine had no time for it is safe and recorded, but shows nothing else. The test
reports that here instead of passing in silence, and the summary shows how much of a run was such.
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
    """Note that the test in progress tolerates this: an error, or a sentence."""
    _in_this_test.append(f"{type(what).__name__}: {what}" if isinstance(what, Exception) else str(what))


def too_busy(what: object) -> NoReturn:
    """Skip the test in progress: the machine had no time for it to begin."""
    tolerated(what)
    pytest.skip(f"too busy: {what}")


def reason_of(recording: Recording) -> str:
    """Return why a run in real time ended; skip the test where it lost its device, which a busy machine does to any."""
    reason = str(recording.trailer["reason"])
    if reason in ("link_silent", "device_fault"):
        too_busy(f"{recording.trailer['error']}; {_place_of_the_loss(recording)}")
    return reason


def _place_of_the_loss(recording: Recording) -> str:
    """Where in the run its device was lost, and how far apart samples were: was the loop held up before, too?"""
    rows = recording.rows
    if len(rows) < 2:
        return f"after {len(rows)} rows"
    phase, apart_ms = phase_name(int(rows["phase"][-1])), np.diff(rows["device_time"]) / 1e6
    longest = int(apart_ms.argmax())
    return f"after {len(rows)} rows, in {phase}; at most {apart_ms[longest]:.1f} ms apart, at row {longest}"


def taken() -> list[tuple[str, str]]:
    """Return what was noted since the last call, as properties of a report."""
    found = [(PROPERTY, what) for what in _in_this_test]
    _in_this_test.clear()
    return found


def summary(reports: Iterable[pytest.TestReport]) -> list[str]:
    """Return a line for each test that tolerated something, most first; none when all showed what they are for."""
    counts = Counter(
        (report.nodeid.partition("[")[0], what.partition(";")[0])
        for report in reports
        for name, what in report.user_properties
        if name == PROPERTY
    )
    return [f"{number} × {test}: {what}" for (test, what), number in counts.most_common()]
