"""At most once: a repeated request gets the same reply and is not executed again.

The host repeats a request whose answer did not come in time, and cannot know which of the two was lost.
Questions may be answered as often as they are asked; what changes the device may be done once. The host
waits for each answer before its next request, so one remembered reply is enough.
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
    """The device's memory of the last request that changed something, and of its reply."""

    def __init__(self) -> None:
        self._key: tuple[int, int, int] | None = None
        self._reply: Message | None = None

    def answer(self, event: Event, execute: Callable[[], Message]) -> Message:
        """Return the remembered reply if this request was the last one executed, else that of `execute()`."""
        if event.request not in REMEMBERED:
            return execute()
        if not self.remembers(event) or self._reply is None:
            self._reply = execute()
            self._key = (event.request, event.nonce, event.session)
        return self._reply

    def remembers(self, event: Event) -> bool:
        """Return True if a request repeats the last executed one: its reply is sent again, and nothing is executed."""
        return self._reply is not None and self._key == (event.request, event.nonce, event.session)

    def forget(self) -> None:
        """Remember nothing: after a reset of the device."""
        self._key = self._reply = None
