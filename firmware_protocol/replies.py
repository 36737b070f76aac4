"""Execute each request at most once: a device answers a repeated request with its stored reply.

The host repeats a request if the reply does not arrive in time; it cannot detect whether request or reply was lost.
Requests that only read may be executed again; a request that changes the device must not.
"""

from collections.abc import Callable

from firmware_protocol.connection import Event
from firmware_protocol.messages import Arm, Disarm, Message, SetBegin, SetCommit
from firmware_protocol.packing import type_id_of

# SET_BEGIN is harmless to repeat; it is here to make the device forget the SET_COMMIT of an earlier host
# process that happened to use the same nonce.
REMEMBERED = frozenset(type_id_of(cls) for cls in (SetBegin, SetCommit, Arm, Disarm))


class Replies:
    """A device's memory of its last request that changes something (a type in `REMEMBERED`), and of the reply."""

    def __init__(self) -> None:
        # One reply is enough, because the host waits for each reply before its next request.
        self._key: tuple[int, int, int] | None = None
        self._reply: Message | None = None

    def answer(self, event: Event, execute: Callable[[], Message]) -> Message:
        """Return the stored reply if the request repeats the last executed one, else the result of `execute()`."""
        if event.request not in REMEMBERED:
            return execute()
        if not self.remembers(event) or self._reply is None:
            self._reply = execute()
            self._key = (event.request, event.nonce, event.session)
        return self._reply

    def remembers(self, event: Event) -> bool:
        """Return True if a request repeats the last executed one, so that the device must send the stored reply."""
        return self._reply is not None and self._key == (event.request, event.nonce, event.session)

    def forget(self) -> None:
        """Delete the stored request and its reply; the device calls this after a reset."""
        self._key = self._reply = None
