"""Clocks for the times in a session's log.

The log and simulated persons use them. They must not time a control loop.
"""

import time
from typing import Protocol


class SessionClock(Protocol):
    """Clock of a session: real time, or a virtual time that only its methods advance, for a simulated person."""

    def __call__(self) -> float:
        """Return the current time (s since 1970, or since the start of a virtual clock)."""
        ...

    def took(self, seconds: float) -> None:
        """Advance a virtual clock by the duration of an action (s); a real clock ignores the call."""
        ...

    def resume_at(self, at: float) -> None:
        """Set a virtual clock to `at` (s), the time of the newest event in the log; a real clock ignores the call."""
        ...


class WallClock:
    """Clock of a session with a real person: the time of day."""

    def __call__(self) -> float:
        """Return the current time (s since 1970)."""
        return time.time()

    def took(self, seconds: float) -> None:
        """Do nothing: the duration has already passed on this real clock."""

    def resume_at(self, at: float) -> None:
        """Do nothing: this real clock advances by itself."""
