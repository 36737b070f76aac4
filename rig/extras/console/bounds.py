"""Limit what a connection may use of the server: before its token is checked, and then in sockets and messages.

Before its token is checked, a connection may send only the head of one HTTP request, of at most `MOST_HEAD_BYTES`. It
holds one of `MOST_AT_DOOR` places for at most `DOOR_S`; if all are taken, the newest connection replaces the oldest.
Frames are parsed only after the token was checked. Connections are accepted one at a time, between turns of the
sockets of pages, so that a flood of connections blocks no page and delays no STOP
(`tests/benchmarks/console_flood.py`).
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
    """A limited number of members; if there are too many, the one that was silent longest is dropped.

    Parameters
    ----------
    most
        Greatest number of members.
    lose
        Called with the member that is dropped.
    """

    def __init__(self, most: int, lose: Callable[[One], None]) -> None:
        self._most, self._lose = most, lose
        self._taken: dict[One, None] = {}  # silent longest first

    def hear(self, one: One) -> None:
        """Add `one` as a member, or note that this member has just sent something."""
        self._taken.pop(one, None)
        self._taken[one] = None
        if len(self._taken) > self._most:
            lost = next(iter(self._taken))
            del self._taken[lost]
            self._lose(lost)

    def leave(self, one: One) -> None:
        """Remove the member `one`, if it is a member."""
        self._taken.pop(one, None)


class Allowance:
    """Rate limit of one socket: `MOST_A_SECOND` messages a second, and as many in one burst."""

    def __init__(self) -> None:
        self._left, self._counted = MOST_A_SECOND, time.monotonic()

    def take(self) -> bool:
        """Count a message. Return False if it exceeds the rate limit."""
        now = time.monotonic()
        self._left = min(MOST_A_SECOND, self._left + (now - self._counted) * MOST_A_SECOND) - 1.0
        self._counted = now
        return self._left >= 0.0


class Knocking(ServerConnection):
    """A connection whose token is not checked yet. It is aborted after `DOOR_S` unless `let_in` is called."""

    def __init__(self, door: Places[Knocking], *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._door = door
        self._head: bytearray | None = bytearray()  # None: it has been let in

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See `asyncio.Protocol.connection_made`."""
        super().connection_made(transport)
        self._due = self.loop.call_later(DOOR_S, self.transport.abort)
        self._door.hear(self)

    def data_received(self, data: bytes) -> None:
        """Pass one complete HTTP head to the library; abort a connection that sends more before it has been let in."""
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
        """Remove the limits of this connection: its token was right."""
        self._head = None
        self.leave_door()

    def leave_door(self) -> None:
        """Free the connection's place, and cancel its timeout."""
        self._due.cancel()
        self._door.leave(self)

    def connection_lost(self, error: Exception | None) -> None:
        """See `asyncio.Protocol.connection_lost`."""
        self.leave_door()
        super().connection_lost(error)


def let_in(socket: ServerConnection) -> None:
    """Remove the limits of a connection that `door` made: its token was right."""
    assert isinstance(socket, Knocking)
    socket.let_in()


def door() -> Any:
    """Return a constructor of connections that share `MOST_AT_DOOR` places; `serve` uses it for `ServerConnection`."""
    return partial(Knocking, Places[Knocking](MOST_AT_DOOR, lambda socket: socket.transport.abort()))
