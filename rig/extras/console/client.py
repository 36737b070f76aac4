"""The queue of messages to one page: limited in memory, even if the page reads slowly.

A page that reads slowly receives the newest state and few long frames of its scope. It delays no other page.
"""

import asyncio
import json
import traceback
from collections.abc import Mapping
from typing import Any

from rig.core.errors import RigError
from rig.core.present import plain
from rig.extras.console.bounds import Allowance
from rig.extras.console.follow import Followed
from rig.extras.console.sockets import ServerConnection
from rig.extras.console.view import View, ViewRequest

# Messages that may wait for one page; with more, its socket is closed, or a stuck page would fill the memory.
MOST_REPLIES = 200


class Client:
    """A connected page whose token was valid, with its queue of messages.

    Attributes
    ----------
    name
        Random name that the page chose; its two sockets give the same name.
    participant
        True for a participant's screen, which shows and requests only what a participant may know.
    shown, paused
        Columns, window and trigger of the page's scope, and True if the scope is paused.
    allowance
        Rate limit of the messages that the page sends.
    """

    def __init__(self, socket: ServerConnection, name: str, *, participant: bool = False) -> None:
        self.name, self.participant = name, participant
        self.shown, self.paused = ViewRequest(), False
        self._socket = socket
        self._view: View | None = None
        self._replies: list[str | bytes] = []
        self._newest: dict[str, str] = {}
        self._wake = asyncio.Event()
        self.allowance = Allowance()

    def reply(self, number: int, result: Any = None, error: RigError | None = None) -> None:
        """Queue the result or the error of the request that the page numbered `number`."""
        answer = {"say": "answer", "to": number}
        answer |= {"result": plain(result)} if error is None else {"error": error.as_mapping()}
        self.put(json.dumps(answer))

    def put(self, message: str | bytes) -> None:
        """Queue a message that must be sent; close the socket if `MOST_REPLIES` messages are waiting already."""
        if len(self._replies) < MOST_REPLIES:
            self._replies.append(message)
        else:
            self._socket.transport.abort()
        self._wake.set()

    def put_newest(self, message: Mapping[str, Any]) -> None:
        """Queue a message that replaces an unsent message with the same value of the key "say"."""
        self._newest[str(message["say"])] = json.dumps(plain(message))
        self._wake.set()

    def compiles(self, busy: bool) -> None:
        """Report to the page that machine code for its request is being compiled (`busy`), or is ready."""
        self.put_newest({"say": "compiling", "busy": busy})

    def show(
        self, followed: Followed | None, shown: ViewRequest | None = None, *, paused: bool | None = None
    ) -> None:
        """Set the control loop, columns or pause of the page's scope; None leaves `shown` or `paused` unchanged."""
        self.shown = shown or self.shown
        self.paused = self.paused if paused is None else paused
        self._view = None if followed is None else View(followed.history, followed.rate, self.shown)

    def wake(self) -> None:
        """Make the method `send` continue, because new samples for the page's scope have arrived."""
        self._wake.set()

    async def send(self) -> None:
        """Send queued replies, states and scope frames as fast as the page reads them, until its socket closes."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            replies, self._replies = self._replies, []
            newest, self._newest = self._newest, {}
            for message in [*replies, *newest.values()]:
                await self._socket.send(message)
            for frame in self._frames():
                await self._socket.send(frame)

    def _frames(self) -> list[bytes]:
        if self._view is None or self.paused:
            return []
        try:
            return list(self._view.frames())
        except Exception as error:
            self._view = None
            self.put(trouble(defect("the scope", error)))
            return []


def trouble(error: RigError) -> str:
    """Return the JSON message that reports an error to a page outside of any request."""
    return json.dumps({"say": "trouble", "message": str(error)})


def defect(do: str, error: BaseException) -> RigError:
    """Return the error that a page shows for a bug in the action `do`; print the traceback in the terminal."""
    traceback.print_exception(error)
    return RigError(f"{do}: {error!r}", remedy="report it with the traceback in the console's terminal")
