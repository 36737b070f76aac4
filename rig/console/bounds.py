"""How much of the server anybody may take: places at its door, places for sockets, and messages a second.

A connection waits at the door until it has shown the token. Whoever fills the door has no token: the newest takes the
place of whoever waits longest there, and a page needs its place for some milliseconds, so that it comes through.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Generic, TypeVar

from rig.console.sockets import ServerConnection

One = TypeVar("One")

MOST_AT_DOOR = 64
DOOR_S = 10.0  # from a connection to its token: a page's own file over a slow tunnel takes a part of that
MOST_A_SECOND = 200.0  # messages of a socket


class Places(Generic[One]):
    """So many places; when all are taken, whoever was silent longest loses theirs.

    Parameters
    ----------
    most
        Places.
    lose
        Told who has lost theirs.
    """

    def __init__(self, most: int, lose: Callable[[One], None]) -> None:
        self._most, self._lose = most, lose
        self._taken: dict[One, None] = {}  # silent longest first

    def hear(self, one: One) -> None:
        """Somebody comes, or says something."""
        self._taken.pop(one, None)
        self._taken[one] = None
        if len(self._taken) > self._most:
            lost = next(iter(self._taken))
            del self._taken[lost]
            self._lose(lost)

    def leave(self, one: One) -> None:
        """Somebody goes, and need not have been here."""
        self._taken.pop(one, None)


class Allowance:
    """Messages that a socket may send, `MOST_A_SECOND` of them at once."""

    def __init__(self) -> None:
        self._left, self._counted = MOST_A_SECOND, time.monotonic()

    def take(self) -> bool:
        """Count a message; False when it is one too many."""
        now = time.monotonic()
        self._left = min(MOST_A_SECOND, self._left + (now - self._counted) * MOST_A_SECOND) - 1.0
        self._counted = now
        return self._left >= 0.0


class Knocking(ServerConnection):
    """A connection that stands at the door, for `DOOR_S` at most, until it is let in."""

    def __init__(self, door: Places[Knocking], *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._door = door

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See `asyncio.Protocol`."""
        super().connection_made(transport)
        self._due = self.loop.call_later(DOOR_S, self.transport.abort)
        self._door.hear(self)

    def leave_door(self) -> None:
        """It has shown the token, or is gone."""
        self._due.cancel()
        self._door.leave(self)

    def connection_lost(self, error: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        self.leave_door()
        super().connection_lost(error)


def let_in(socket: ServerConnection) -> None:
    """Let a connection of `door` in: it has shown the token."""
    assert isinstance(socket, Knocking)
    socket.leave_door()


def door() -> Any:
    """Make the connections of one server, which share its door: for `serve`, in place of `ServerConnection`."""
    return partial(Knocking, Places[Knocking](MOST_AT_DOOR, lambda socket: socket.transport.abort()))
