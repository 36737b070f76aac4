"""Clocks for the times in a session's log."""

from __future__ import annotations

import time
from typing import Protocol


class SessionClock(Protocol):
    """Clock of a session: real, or virtual and advanced by its methods (`rig.session.engine._rehearsal.Day`)."""

    def __call__(self) -> float:
        """Return the current time (s since 1970, or since the start of a virtual clock)."""
        ...

    def took(self, seconds: float) -> None:
        """Advance a virtual clock by the duration of an action; a real clock ignores it."""
        ...

    def resume_at(self, at: float) -> None:
        """Set a virtual clock to the time of the newest event in the log; a real clock ignores it."""
        ...


class WallClock:
    """Real time of day."""

    def __call__(self) -> float:
        """Return the current time (s since 1970)."""
        return time.time()

    def took(self, seconds: float) -> None:
        """Do nothing: the duration has already passed on this clock."""

    def resume_at(self, at: float) -> None:
        """Do nothing: this clock advances by itself."""
