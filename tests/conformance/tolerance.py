"""Real-time tests on a busy machine skip where that spoiled them; pytest prints the reason (`-rs`).

A run that lost its link because the machine was too busy is safe and recorded, but proves nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

import numpy as np
import pytest

from rig.core.sample import phase_name

if TYPE_CHECKING:
    from rig.recording.data import Recording


def too_busy(what: object) -> NoReturn:
    """Skip the running test, because the machine was too busy for it to begin."""
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
