"""Helpers that run a session's desk with an operator, at a terminal or at a page of the console.

Desk, seat and service of the page are the real ones; queues replace the processes and sockets between them.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any, cast

from rig.core.errors import StoppedError
from rig.core.present import plain
from rig.core.sample import Phase
from rig.extras.console.client import Client
from rig.extras.console.jobs import Job, Jobs
from rig.extras.console.lease import Lease
from rig.extras.console.service import ServiceContext
from rig.extras.console.session_desk import PageDesk
from rig.extras.console.sessions import JOB, Sessions
from rig.extras.console.talk import Talk
from rig.extras.console.terminal import Terminal as Consents
from rig.realtime.hand import SharedHand
from rig.session.engine._desk import Desk, Reply
from rig.session.planning._protocol import Keys
from rig.session.terminal._asking import AskingDesk
from rig.session.terminal._pointer import HandKind
from rig.session.terminal._seat import keymap_for
from rig.session.terminal.desk import ConsoleDesk, MovedHand
from tests.conformance.started import WAIT_S
from tests.conformance.terminal import Terminal
from tests.extras.console.console_fakes import Here, Page, ask

_BYTES = {"space": " ", "enter": "\r", "f5": "\x1b[15~", "end": "\x1b[F", "home": "\x1b[H", "left": "\x1b[D"}


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"it never came: {what}"
        threading.Event().wait(0.005)


def answered(reply: Future[Reply]) -> tuple[str, str]:
    found = reply.result(WAIT_S)
    return found.action, found.value


def watched(desk: Desk) -> StoppedError:
    """Wait until the desk ends a hit, and return the error by which it does so."""
    watch, deadline = desk.watch(), time.monotonic() + WAIT_S
    assert watch is not None
    try:
        while time.monotonic() < deadline:
            watch(0, Phase.TRIAL)
            threading.Event().wait(0.005)  # the supervision of a loop calls it as often
    except StoppedError as error:
        return error
    raise AssertionError("nothing ended the hit")


class Seated(ABC):
    """An operator at a desk, who presses keys by their names and types lines; `hang` and `leave` end all messages."""

    desk: AskingDesk

    def sees(self, *texts: str) -> None:
        until(lambda: all(text in self.screen for text in texts), f"{texts} on the screen:\n{self.screen}")

    @property
    @abstractmethod
    def screen(self) -> str:
        """Return the text on the screen, or printed since the last key; keys as ``[g] go``."""

    def close(self) -> None:
        self.desk.close()


class AtTerminal(Seated):
    def __init__(self, keys: Keys, hand: tuple[HandKind, Path] | None, silence_s: float) -> None:
        self.terminal = Terminal()
        moved = None if hand is None else MovedHand(path=hand[1], press=4.0)
        try:
            self._console = ConsoleDesk(
                keys, hand=moved, place=Path(self.terminal.path), silence_s=silence_s, hung_s=60.0
            )
        except BaseException:
            self.terminal.close()
            raise
        self.desk = self._console

    @property
    def screen(self) -> str:
        return self.terminal.fresh

    @property
    def rings(self) -> int:
        return self.terminal.bells

    def press(self, key: str) -> None:
        self.terminal.type(_BYTES.get(key, key))

    def line(self, text: str) -> None:
        until(lambda: "then enter:" in self.terminal.printed, "a line to type")
        self.terminal.type(text + "\r")

    def hang(self) -> None:
        os.kill(self._console.pid, signal.SIGSTOP)

    def leave(self) -> None:
        self.terminal.close()

    def close(self) -> None:
        with suppress(ProcessLookupError):
            os.kill(self._console.pid, signal.SIGCONT)  # one that hung ends by itself
        super().close()
        self.terminal.close()


class Line(Talk):
    """The link between a job and its console, whose other end is in this process."""

    def __init__(self, page: AtPage) -> None:
        super().__init__(is_detached=False)
        self._page = page
        self.replies: SimpleQueue[Any] = self._answers

    def tell(self, say: str, /, **content: Any) -> None:
        message = json.loads(json.dumps({"say": say, **plain(content)}))
        self._page.in_loop(self._page.receive(message))

    @property
    def silent_s(self) -> float:
        return time.monotonic() - self._page.hung_s if self._page.hung_s else 0.0


class FakeJob:
    """The part of a job that the service uses; its process is this one."""

    name, asks, is_detached, pid = JOB, True, False, os.getpid()

    def __init__(self, page: AtPage) -> None:
        self._page = page

    async def close(self) -> None:
        self._page.leave()

    def answer(self, value: Any) -> None:
        self._page.line_.replies.put(json.loads(json.dumps(value)))


class FakeClient(Page):
    """A page in a browser, with the newest message of each kind."""

    def __init__(self, name: str, *, participant: bool = False) -> None:
        super().__init__(name)
        self.participant = participant
        self.newest: dict[str, dict[str, Any]] = {}

    def put_newest(self, message: Any) -> None:
        self.newest[message["say"]] = json.loads(json.dumps(message))

    def put(self, message: str) -> None:
        self.put_newest(json.loads(message))


class AtPage(Seated):
    """An operator's page: its service runs in a thread, as in the console's server."""

    def __init__(self, keys: Keys, hand: tuple[HandKind, Path] | None, silence_s: float) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._thread.start()
        self.hung_s = 0.0  # since when it is silent
        self.client = FakeClient("operator")
        self.participant = FakeClient("participant", participant=True)
        self._place = TemporaryDirectory()
        self.hand = SharedHand.create(hand[1] if hand is not None else Path(self._place.name) / "hand")
        self.job, self.line_ = FakeJob(self), Line(self)
        self.jobs = FakeJobs(self.job)
        pages, screens = (cast("set[Client]", {one}) for one in (self.client, self.participant))
        self.shared = ServiceContext(
            pages, Lease(), cast("Jobs", self.jobs), Path(), Here(), participants=screens
        )
        self.service = Sessions(self.shared, self.hand, Consents(), verified=False)
        try:
            self.ask("session", protocol="a.toml", code="P01", hand=hand[0] if hand else "simulated")
            self.desk = PageDesk(
                self.line_, keymap_for(keys, hand and hand[0]), hand and (hand[0], 4.0), silence_s=silence_s
            )
        except BaseException:
            self._end()
            raise

    def in_loop(self, work: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(WAIT_S)

    async def receive(self, message: Any) -> bool:
        return self.service.handle_job_message(cast("Job", self.job), message)

    def ask(self, do: str, client: FakeClient | None = None, **content: Any) -> Any:
        """Send a request as a page's socket would, and return its reply or raise its error."""
        return self.in_loop(ask(self.service, client or self.client, do, **content))

    @property
    def session(self) -> dict[str, Any]:
        return self.client.newest["session"]

    @property
    def screen(self) -> str:
        view = self.session
        if "asked" not in view:
            return ""
        parts = [view["place"], view["state"], view["saying"], view["question"]]
        parts.append("  ".join(f"[{key}] {text}" for key, text in view["offered"]))
        parts += [
            "" if view["entry"] is None else f"{view['entry']}, then enter:",
            view["notice"],
            view["hand"],
            view["last"],
        ]
        parts += [f"{name} {text}" for name, text in view["facts"]]
        parts += [f"{name} {text}" for name, _, text in view["gauges"]]
        parts += [f"{key} {meaning}" for key, meaning in view["keys"]] if view["help"] else []
        return "\n".join([*parts, *view["lines"]])

    @property
    def rings(self) -> int:
        return int(self.session["rings"])

    def press(self, key: str) -> None:
        self.ask("session_key", key=key, asked=self.session["asked"])

    def line(self, text: str) -> None:
        until(lambda: self.session["entry"] is not None, "a line to type")
        self.ask("session_line", text=text, asked=self.session["asked"])

    def hang(self) -> None:
        self.hung_s = time.monotonic()

    def leave(self) -> None:
        self.line_.replies.put(None)

    def close(self) -> None:
        super().close()
        self._end()

    def _end(self) -> None:
        self.in_loop(self._closed())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(WAIT_S)
        self._loop.close()
        self.hand.close()
        self._place.cleanup()

    async def _closed(self) -> None:
        await self.service.close()
        await asyncio.sleep(0)  # what was cancelled ends


class FakeJobs:
    def __init__(self, job: FakeJob) -> None:
        self.job, self.running = job, None
        self.started: dict[str, Any] = {}

    async def start(
        self, name: str, content: Any, *, asks: bool = False, is_detached: bool = False
    ) -> FakeJob:
        assert name == JOB
        self.job.asks, self.started = asks, dict(content)
        return self.job


Place = AtTerminal | AtPage
PLACES: dict[str, type[AtTerminal] | type[AtPage]] = {"terminal": AtTerminal, "page": AtPage}
