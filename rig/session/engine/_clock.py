"""What the times of a session's log are taken from."""

from __future__ import annotations

import time
from typing import Protocol


class SessionClock(Protocol):
    """A clock that may have to be moved on (`rig.session.engine._rehearsal.Day`)."""

    def __call__(self) -> float:
        """Return the current time (s since the epoch, or since a virtual begin)."""
        ...

    def took(self, seconds: float) -> None:
        """Something took so long, on whatever clock it had."""
        ...

    def resume_at(self, at: float) -> None:
        """Continue a clock that is moved by hand from the time of the newest event."""
        ...


class WallClock:
    """The clock on the wall."""

    def __call__(self) -> float:
        """Return the current time in seconds since the epoch."""
        return time.time()

    def took(self, seconds: float) -> None:
        """Ignore the duration, which has passed on this clock."""

    def resume_at(self, at: float) -> None:
        """Ignore the time of the newest event; this clock moves by itself."""
