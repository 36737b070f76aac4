"""Execute each request at most once: a repeated request gets the same reply again.

The host repeats a request if the reply does not arrive in time; it cannot detect whether request or reply was lost.
Requests that only read may be executed again; a request that changes the device must not. The host waits for each reply
before its next request, so storing one reply is enough.
"""

from __future__ import annotations

from collections.abc import Callable

from firmware_protocol.connection import Event
from firmware_protocol.messages import Arm, Disarm, Message, SetBegin, SetCommit
from firmware_protocol.packing import type_id_of

# SET_BEGIN is harmless to repeat; it is here to make the device forget the SET_COMMIT of an earlier host
# process that happened to use the same nonce.
REMEMBERED = frozenset(type_id_of(cls) for cls in (SetBegin, SetCommit, Arm, Disarm))


class Replies:
    """The device's memory of its last request of a type in `REMEMBERED`, and of the reply."""

    def __init__(self) -> None:
        self._key: tuple[int, int, int] | None = None
        self._reply: Message | None = None

    def answer(self, event: Event, execute: Callable[[], Message]) -> Message:
        """Return the stored reply if this request was the last one executed; otherwise execute it."""
        if event.request not in REMEMBERED:
            return execute()
        if not self.remembers(event) or self._reply is None:
            self._reply = execute()
            self._key = (event.request, event.nonce, event.session)
        return self._reply

    def remembers(self, event: Event) -> bool:
        """Return True if a request repeats the last executed one, so that its reply is sent again."""
        return self._reply is not None and self._key == (event.request, event.nonce, event.session)

    def forget(self) -> None:
        """Delete the stored reply, after a reset of the device."""
        self._key = self._reply = None
