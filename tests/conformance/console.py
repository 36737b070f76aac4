"""A console that a test serves in its own event loop, and clients that stand in for browser pages."""

from __future__ import annotations

import asyncio
import json
import os
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from rig.extras.console.server import ConsoleSettings, run
from rig.extras.console.terminal import Terminal
from rig.realtime.memories import LoopMemory, ask_to_stop
from rig.realtime.running import RunningLoop, running
from tests.conformance.started import WAIT_S


class Page:
    """The socket of a page or of a participant's screen, with the messages that it has received."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.messages: list[dict[str, Any]] = []
        self.frames: list[dict[str, Any]] = []
        self.closed: ConnectionClosed | None = None
        self._number = 0
        self._news = asyncio.Event()
        self._reader = asyncio.create_task(self._read())

    async def _read(self) -> None:
        try:
            await self._read_all()
        except ConnectionClosed as closed:
            self.closed = closed
        self._news.set()

    async def _read_all(self) -> None:
        while True:
            data = await self.socket.recv()
            if isinstance(data, bytes):
                (length,) = struct.unpack_from("<I", data)
                self.frames.append(json.loads(data[4 : 4 + length]) | {"bytes": len(data)})
            else:
                self.messages.append(json.loads(data))
            self._news.set()

    async def until(self, found: Callable[[Page], Any]) -> Any:
        """Wait until a condition on the received messages is true, and return its value."""
        async with asyncio.timeout(WAIT_S):
            while not (result := found(self)):
                if self.closed is not None:
                    raise self.closed
                self._news.clear()
                await self._news.wait()
            return result

    async def say(self, do: str, **content: Any) -> None:
        """Send a request that has no reply."""
        await self.socket.send(json.dumps({"do": do, **content}))

    async def ask(self, do: str, **content: Any) -> dict[str, Any]:
        """Send a request and return its reply, which contains `result` or `error`."""
        self._number += 1
        number = self._number
        await self.say(do, number=number, **content)
        answer: dict[str, Any] = await self.until(lambda page: page.answer(number))
        return answer

    def answer(self, number: int) -> dict[str, Any] | None:
        """Return the reply to a request; None before it has arrived."""
        return next((one for one in self.messages if one["say"] == "answer" and one["to"] == number), None)

    def newest(self, say: str) -> dict[str, Any] | None:
        """Return the last message of a kind, or None."""
        return next((one for one in reversed(self.messages) if one["say"] == say), None)


class Served:
    """A running console: its address, its token, and connections to it."""

    def __init__(self, url: str) -> None:
        self.address, self.token = url.removeprefix("http://").split("/#")
        self.port = int(self.address.rpartition(":")[2])

    def socket(
        self,
        path: str = "/live",
        *,
        token: str | None = None,
        client: str = "the-first-page",
        origin: str | None = None,
        host: str | None = None,
    ) -> Any:
        """Open a connection as a page does, or, with other arguments, as an intruder does."""
        return connect(
            f"ws://{host or self.address}{path}{'&' if '?' in path else '?'}client={client}",
            origin=origin or f"http://{self.address}",  # type: ignore[arg-type]
            subprotocols=["rig", f"token.{self.token if token is None else token}"],  # type: ignore[list-item]
            host="127.0.0.1", port=self.port, proxy=None, close_timeout=0.5,
        )  # fmt: skip

    @asynccontextmanager
    async def page(self, name: str = "the-first-page") -> AsyncIterator[Page]:
        """Connect a page that has sent the token."""
        async with self.socket(client=name) as socket:
            page = Page(socket)
            await page.until(lambda page: page.newest("hello"))
            yield page

    @asynccontextmanager
    async def screen(self, token: str) -> AsyncIterator[Page]:
        """Connect a participant's screen that has sent its token."""
        async with self.socket("/participant", token=token, client="a-participant") as socket:
            page = Page(socket)
            await page.until(lambda page: page.newest("participant"))
            yield page

    @asynccontextmanager
    async def hold(self, name: str = "the-first-page") -> AsyncIterator[ClientConnection]:
        """Open the socket of a page's worker."""
        async with self.socket("/hold", client=name) as socket:
            yield socket


def processes_of_this_test() -> list[int]:
    """Return the numbers of this process and of its descendants."""
    found, left = [], [os.getpid()]
    while left:
        found.append(left.pop())
        with suppress(OSError):  # it has ended
            left += [
                int(name)
                for file in Path(f"/proc/{found[-1]}/task").glob("*/children")
                for name in file.read_text().split()
            ]
    return found


def stop_of_this_test() -> list[LoopMemory]:
    """Set the stop words of this test's loops only; other tests and users may run loops beside it."""
    return [memory for pid in processes_of_this_test() for memory in ask_to_stop(pid)]


def loops_of_this_test() -> list[RunningLoop]:
    """Return the running loops of this test, the only ones that its console may show and stop."""
    mine = processes_of_this_test()
    return [loop for loop in running() if loop.pid in mine]


@asynccontextmanager
async def served(place: Path, terminal: Terminal | None = None, **settings: Any) -> AsyncIterator[Served]:
    """Serve a console until the block ends, with all that it started; its STOP reaches only this test's loops."""
    ended, urls = asyncio.Event(), asyncio.Queue[str]()
    made = ConsoleSettings(output=place, announce=urls.put_nowait, **settings)
    task = asyncio.create_task(run(made, terminal or Terminal(), ended))
    first = asyncio.create_task(urls.get())
    patch = pytest.MonkeyPatch()
    patch.setattr("rig.extras.console.live.ask_to_stop", stop_of_this_test)
    patch.setattr("rig.extras.console.follow.running", loops_of_this_test)
    try:
        await asyncio.wait([task, first], return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            task.result()
        yield Served(first.result())
    finally:
        ended.set()
        try:
            await task
        finally:
            patch.undo()
