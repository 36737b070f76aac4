"""Who operates: one page, as long as it is heard of; the others look on.

The page's heartbeat comes from a worker of its own, since browsers throttle the timers of hidden pages, and says that
the page itself has answered that worker. A beat is due within `BEAT_S`; a page that is silent for `LOST_S` operates no
more, and what it moves stops.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

BEAT_S = 0.3
LOST_S = 1.0
LOOK_S = 0.05


@dataclass(frozen=True, slots=True)
class Held:
    """How the lease stands: who has it (None: nobody), and whether a beat is overdue."""

    by: str | None
    overdue: bool


class Lease:
    """One operator at a time.

    Parameters
    ----------
    now
        The time (s, monotonic).
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._by: str | None = None
        self._heard = 0.0
        self._looked = now()

    def take(self, client: str) -> bool:
        """Operate, if nobody else does; whether `client` does now."""
        if self._by is None:
            self._by, self._heard = client, self._now()
        return self._by == client

    def beat(self, client: str) -> None:
        """A page was heard of."""
        if client == self._by:
            self._heard = self._now()

    def release(self, client: str) -> None:
        """Operate no more."""
        if client == self._by:
            self._by = None

    def held(self) -> Held:
        """How it stands now."""
        return Held(self._by, self._by is not None and self._now() - self._heard > BEAT_S)

    def expire(self) -> str | None:
        """Take it from a page that was not heard of for too long: that page, once; else None.

        To be called every `LOOK_S`. Who calls late did not listen either, and counts no silence for that time.
        """
        now = self._now()
        self._heard = min(now, self._heard + max(0.0, now - self._looked - 2.0 * LOOK_S))
        self._looked = now
        if self._by is None or now - self._heard <= LOST_S:
            return None
        gone, self._by = self._by, None
        return gone
