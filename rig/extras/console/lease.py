"""Decide which page operates the rig: one page, while its heartbeats arrive; the other pages only watch.

The server calls `Lease.expire` every `LOOK_S` (s). A web worker of the page sends the heartbeats, because browsers
throttle the timers of hidden pages. The worker sends them only while the page itself replies to the worker.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

BEAT_S = 0.3
LOST_S = 1.0
LOOK_S = 0.05


@dataclass(frozen=True, slots=True)
class LeaseState:
    """Name of the page that operates (None: no page), and True if its heartbeat is overdue."""

    by: str | None
    overdue: bool


class Lease:
    """The right to operate the rig, which one page has at a time; `now` returns the time (s, monotonic)."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._by: str | None = None
        self._last_beat_s = 0.0
        self._last_call_s = now()
        self._found_silent_late = False  # a late call of `expire` found the page silent

    def take(self, client: str) -> bool:
        """Let `client` operate the rig if no page operates; return True if `client` operates now."""
        if self._by is None:
            self._by, self._last_beat_s, self._found_silent_late = client, self._now(), False
        return self._by == client

    def beat(self, client: str) -> None:
        """Note a heartbeat of `client`; ignore it if `client` does not operate."""
        if client == self._by:
            self._last_beat_s, self._found_silent_late = self._now(), False

    def release(self, client: str) -> None:
        """End the right of `client` to operate the rig, if it has this right."""
        if client == self._by:
            self._by = None

    def held(self) -> LeaseState:
        """Return which page operates the rig, and whether its heartbeat is overdue."""
        return LeaseState(self._by, self._by is not None and self._now() - self._last_beat_s > BEAT_S)

    def expire(self) -> str | None:
        """End the right of a page that was silent for more than `LOST_S` (s) to operate the rig.

        Return the page's name once, else None. Call this every `LOOK_S` (s).
        """
        now = self._now()
        late, self._last_call_s = now - self._last_call_s > 2.0 * LOOK_S, now
        if self._by is None or now - self._last_beat_s <= LOST_S:
            return None
        # A server that looks late did not listen either, and beats may wait in its socket: look once more. One that is
        # later than `rig.extras.console.talk.SILENT_S` is taken to hang by the job itself.
        if late and not self._found_silent_late:
            self._found_silent_late = True
            return None
        gone, self._by = self._by, None
        return gone
