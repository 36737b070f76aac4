"""Limit connections and messages, before and after the token of a connection was checked.

Before its token is checked, a connection may send only the head of one HTTP request, of at most `MOST_HEAD_BYTES`. At
most `MOST_AT_DOOR` such connections exist, each for at most `DOOR_S` (s); one more replaces the oldest. Frames are
parsed only after the token was checked. Connections are accepted one at a time, alternating with the sockets of open
pages, so that a flood of connections blocks no page and delays no STOP (`tests/benchmarks/console_flood.py`).
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
# A page sends 700 bytes, and the cookies that other servers of this computer have set.
MOST_HEAD_BYTES = 1 << 14
# Longest time from a connection to its token; the file of the page over a slow tunnel takes a part of it.
DOOR_S = 10.0
HEAD_END = b"\r\n\r\n"
MOST_A_SECOND = 200.0  # messages per second of one socket


class Places(Generic[One]):
    """A set of at most `most` members; one more replaces the member that was silent longest, which `lose` receives."""

    def __init__(self, most: int, lose: Callable[[One], None]) -> None:
        self._most, self._lose = most, lose
        self._taken: dict[One, None] = {}  # ordered by last activity, the longest silent first

    def hear(self, one: One) -> None:
        """Add `one` as a member, or note that this member has just sent something."""
        self._taken.pop(one, None)
        self._taken[one] = None
        if len(self._taken) > self._most:
            lost = next(iter(self._taken))
            del self._taken[lost]
            self._lose(lost)

    def leave(self, one: One) -> None:
        """Remove `one` from the members, if it is a member."""
        self._taken.pop(one, None)


class Allowance:
    """Rate limit of one socket: `MOST_A_SECOND` messages a second on average, and as many in one burst."""

    def __init__(self) -> None:
        self._tokens, self._counted = MOST_A_SECOND, time.monotonic()

    def take(self) -> bool:
        """Count a message; return False if the message exceeds the rate limit."""
        now = time.monotonic()
        self._tokens = min(MOST_A_SECOND, self._tokens + (now - self._counted) * MOST_A_SECOND) - 1.0
        self._counted = now
        return self._tokens >= 0.0


class Knocking(ServerConnection):
    """A connection whose token is not checked yet; the server aborts it after `DOOR_S` (s) unless it calls `let_in`."""

    def __init__(self, door: Places[Knocking], *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._door = door
        self._head: bytearray | None = bytearray()  # None after the token was checked

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the timeout of the connection; asyncio calls this when the connection is open."""
        super().connection_made(transport)
        self._due = self.loop.call_later(DOOR_S, self.transport.abort)
        self._door.hear(self)

    def data_received(self, data: bytes) -> None:
        """Pass one complete HTTP head to websockets; abort a connection that sends more before its token is checked."""
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
        """Remove the limits of this connection, because its token is valid."""
        self._head = None
        self.leave_door()

    def leave_door(self) -> None:
        """Cancel the connection's timeout, and stop counting it among the connections without a checked token."""
        self._due.cancel()
        self._door.leave(self)

    def connection_lost(self, error: Exception | None) -> None:
        """Stop the timeout of the connection; asyncio calls this when the connection is closed."""
        self.leave_door()
        super().connection_lost(error)


def let_in(socket: ServerConnection) -> None:
    """Remove the limits of a connection of class `Knocking`, because its token is valid."""
    assert isinstance(socket, Knocking)
    socket.let_in()


def door() -> Any:
    """Return the class argument of `websockets.serve`: it creates connections that share the `MOST_AT_DOOR` limit."""
    return partial(Knocking, Places[Knocking](MOST_AT_DOOR, lambda socket: socket.transport.abort()))
