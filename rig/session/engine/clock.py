"""What the times of a session's log are taken from."""

from __future__ import annotations

import time
from typing import Protocol


class SessionClock(Protocol):
    """A clock that may have to be moved on (`rig.session.engine.rehearsal.Day`)."""

    def __call__(self) -> float:
        """Time of day (s)."""
        ...

    def took(self, seconds: float) -> None:
        """Something took so long, on whatever clock it had."""
        ...

    def goes_on_from(self, at: float) -> None:
        """The newest event so far was then."""
        ...


class WallClock:
    """The clock on the wall."""

    def __call__(self) -> float:
        """Time of day (s)."""
        return time.time()

    def took(self, seconds: float) -> None:
        """It has passed already."""

    def goes_on_from(self, at: float) -> None:
        """It moves by itself."""
