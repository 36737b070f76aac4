"""Limit what a connection may cost the server: before its token, and after it in sockets and messages a second.

Before the token a connection may send the head of one HTTP request, of bounded size, and has one of a few places for a
bounded time; the newest takes the place of the oldest. A frame is parsed only after the token.
Connections are accepted one at a time, between turns of the sockets of pages, so that a flood keeps no page out and
delays no STOP (`tests/benchmarks/console_flood.py`).
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Generic, TypeVar

from rig.extras.console.sockets import ServerConnection

One = TypeVar("One")

MOST_AT_DOOR = 64
MOST_HEAD_BYTES = 1 << 14  # a page sends 700, and the cookies that other servers of this computer have set
DOOR_S = 10.0  # from a connection to its token: a page's own file over a slow tunnel takes a part of that
HEAD_END = b"\r\n\r\n"
MOST_A_SECOND = 200.0  # messages of a socket


class Places(Generic[One]):
    """A limited number of places; when all are taken, the member that was silent longest is dropped.

    Parameters
    ----------
    most
        Number of places.
    lose
        Called with the member that is dropped.
    """

    def __init__(self, most: int, lose: Callable[[One], None]) -> None:
        self._most, self._lose = most, lose
        self._taken: dict[One, None] = {}  # silent longest first

    def hear(self, one: One) -> None:
        """Give `one` a place, or note that it sent something."""
        self._taken.pop(one, None)
        self._taken[one] = None
        if len(self._taken) > self._most:
            lost = next(iter(self._taken))
            del self._taken[lost]
            self._lose(lost)

    def leave(self, one: One) -> None:
        """Free the place of `one`, if it has one."""
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
        self._head: bytearray | None = bytearray()  # None: it has been let in

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See `asyncio.Protocol`."""
        super().connection_made(transport)
        self._due = self.loop.call_later(DOOR_S, self.transport.abort)
        self._door.hear(self)

    def data_received(self, data: bytes) -> None:
        """Give the library a whole head and nothing behind it; abort what sends more before it is let in."""
        if self._head is not None:
            self._head += data
            end = self._head.find(HEAD_END)
            most = MOST_HEAD_BYTES if end < 0 else min(MOST_HEAD_BYTES, end + len(HEAD_END))
            if len(self._head) > most:
                self.transport.abort()
            if end < 0 or len(self._head) > most:
                return
            data = bytes(self._head)
        super().data_received(data)

    def let_in(self) -> None:
        """The token was shown: read on without these bounds."""
        self._head = None
        self.leave_door()

    def leave_door(self) -> None:
        """Free the place of a connection that has shown its token."""
        self._due.cancel()
        self._door.leave(self)

    def connection_lost(self, error: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        self.leave_door()
        super().connection_lost(error)


def let_in(socket: ServerConnection) -> None:
    """Let a connection of `door` in: it has shown the token."""
    assert isinstance(socket, Knocking)
    socket.let_in()


def door() -> Any:
    """Make the connections of one server, which share its door: for `serve`, in place of `ServerConnection`."""
    return partial(Knocking, Places[Knocking](MOST_AT_DOOR, lambda socket: socket.transport.abort()))
