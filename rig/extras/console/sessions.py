"""Handle a page's requests about sessions: begin, resume and operate them by the rules of a session at a terminal.

The server sends texts and receives keys and lines. A key is sent with the number of the question that was open when it
was pressed; a key for an earlier question is ignored. A participant's screen shows only what a participant may see, and
can answer only verdicts and questionnaire items.
"""

import asyncio
import math
import time
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from typing import Any

from rig.core.errors import ConfigError, RigError
from rig.extras.console import consent
from rig.extras.console.client import Client, defect
from rig.extras.console.jobs import Job
from rig.extras.console.requests import Request
from rig.extras.console.service import Handler, Service, ServiceContext
from rig.extras.console.session_requests import BeginSession, ListSessions, PressKey, Reach, TypeLine
from rig.extras.console.terminal import Terminal
from rig.realtime.hand import SharedHand
from rig.session.page import (
    LATER,
    START_SHARE,
    STOP,
    VERDICTS,
    WALL_SHARE,
    Conversation,
    Seat,
    SeatHand,
    instruct,
    words,
)

JOB = "session"
PARTICIPANTS = ("session_key", "session_line", "stop")  # requests that a participant's screen may send
MOVING = ("go", "hold")  # states in which the participant moves the handle
ROUND_S = 0.08  # between two updates of the session's state


class Sessions(Service):
    """Service for requests about sessions: it starts a session's process, shows its state, and sends it keys."""

    def __init__(
        self, shared: ServiceContext, hand: SharedHand, terminal: Terminal, *, verified: bool
    ) -> None:
        self._shared, self._hand, self._terminal = shared, hand, terminal
        self._verified = verified
        self._job: Job | None = None
        self._seat: Seat | None = None
        self._rounds: asyncio.Task[None] | None = None
        self._end: Mapping[str, Any] | None = None  # end of the last session
        self._compiling = False
        self._rings = 0
        self._sent: dict[str, Any] = {}

    def handlers(self) -> Mapping[str, tuple[type[Request], Handler]]:
        """Return request class and handler of each request about sessions, by the request's name."""
        return {
            "sessions": (ListSessions, self._list),
            "session": (BeginSession, self._begin),
            "session_key": (PressKey, self._key),
            "session_line": (TypeLine, self._line),
            "session_hand": (Reach, self._reach),
        }

    def greet(self, client: Client) -> None:
        """Send the state of the running session to a page that connects."""
        for pages, message in self._messages():
            if client.participant == (pages is self._shared.participants):
                client.put_newest(message)

    async def _list(self, client: Client, request: ListSessions) -> object:
        async def found() -> Any:
            return (await self._shared.errands.run("sessions"))[0]

        return self.answer_later(client, request, found())

    async def _begin(self, client: Client, request: BeginSession) -> object:
        self._shared.must_operate(client)
        if not request.directory and not (request.protocol and request.code):
            raise ConfigError(
                "a new session needs a protocol and a participant's code", remedy="give protocol and code"
            )
        person, url, realtime = request.person is not None, request.url, request.realtime
        if request.directory:
            # A resumed session continues as its log states, on the same device unless the request names another.
            log, _ = await self._shared.errands.run("resumed", directory=request.directory)
            person, url, realtime = log["rehearsed"], request.url or log["url"], log["realtime"]
        content = asdict(request) | {
            "digest": None,
            "url": url,
            "realtime": realtime,
            "verified": self._verified,
            "hand": str(self._hand.path),
            "hand_kind": None if request.hand == "simulated" or person else request.hand,
        }
        if url and not url.startswith("sim:"):
            return self.answer_later(
                client, request, self._begin_agreed(client, request, content, asks=not person)
            )
        return await self._start(content, asks=not person)

    async def _begin_agreed(
        self, client: Client, request: BeginSession, content: dict[str, Any], *, asks: bool
    ) -> dict[str, Any]:
        url = content["url"]
        content["digest"], _ = await self._shared.errands.run(
            "session digest", protocol=request.protocol, directory=request.directory
        )
        lines = consent.describe_session(request, url, content["digest"])
        await consent.insist(self._terminal, client, url, lines)
        self._shared.must_operate(client)  # still: a person takes their time
        return await self._start(content, asks=asks)

    async def _start(self, content: Mapping[str, Any], *, asks: bool) -> dict[str, Any]:
        job = self._job = await self._shared.jobs.start(JOB, content, asks=asks)
        self._shared.blinded = True  # until the session reports that its operator is not blinded
        self._seat, self._end, self._compiling = None, None, False
        self._rounds = asyncio.create_task(self._every_round(job))
        self._update_pages()
        return {"pid": job.pid}

    # At the desk.

    async def _key(self, client: Client, request: PressKey) -> None:
        seat = self._seat
        if seat is None or self._job is None:
            return
        now_s = time.monotonic()
        if request.key != STOP:
            # STOP alone may come from any page at any time.
            if not self._may_send(client, seat, request, "verdict"):
                # The key was pressed before the next question appeared, so it must not answer that question.
                seat.talk.held.arrive(request.key, now_s)
                return
            if client.participant and seat.talk.keymap.meaning(request.key) not in VERDICTS:
                return
        seat.key(request.key, now_s, request.shown_s)
        self._update_pages()

    async def _line(self, client: Client, request: TypeLine) -> None:
        seat = self._seat
        if seat is None or self._job is None or not self._may_send(client, seat, request, "item"):
            return
        seat.do(seat.talk.line(request.text), request.shown_s)
        self._update_pages()

    async def _reach(self, client: Client, request: Reach) -> None:
        self._shared.must_operate(client)
        if self._seat is not None and self._seat.hand is not None:
            self._seat.hand.pointer.point(request.share, held=request.held)

    def _may_send(self, client: Client, seat: Seat, request: PressKey | TypeLine, kind: str) -> bool:
        """Return True if a page may send this key or line now; a participant may only answer the open question."""
        talk = seat.talk
        if request.asked != talk.asked:
            return False
        if not client.participant:
            self._shared.must_operate(client)
            return True
        purpose = None if talk.entry is None else talk.entry.purpose
        return (
            talk.question is not None
            and talk.question.kind == kind
            and talk.twice is None
            and purpose == ("item" if kind == "item" else None)
        )

    # Messages of the session, and what a page is sent.

    def handle_job_message(self, job: Job, message: Mapping[str, Any]) -> bool:
        """Update the session's state from a message of its job; return True if pages must not receive the message."""
        if job.name != JOB:
            return False
        kind = message["say"]
        match kind:
            case "setup":
                self._seat = Seat(message, partial(_send, job), self._create_hand(message["hand"]))
            case "view" | "ask":
                assert self._seat is not None
                self._rings += self._seat.receive(kind, message, time.monotonic())
                self._shared.blinded = self._seat.talk.view.blinded
            case "done":
                self._end = message["result"]
            case "failed":
                why = RigError(message["error"], remedy=message["remedy"])
                self._end = {"stands": str(why), "pairs": [], "over": False}
            case "compiling":
                self._compiling = bool(message["busy"])
            case "ended":
                self._leave()
            case _:
                return False
        self._update_pages()
        return kind not in ("compiling", "ended")

    def _create_hand(self, hand: Mapping[str, Any] | None) -> SeatHand | None:
        return None if hand is None else SeatHand(hand["kind"], float(hand["press"]), self._hand)

    def _leave(self) -> None:
        self._job = None
        self._shared.blinded = False
        if self._seat is not None:
            self._seat.live.close()
        if self._rounds is not None:
            self._rounds.cancel()
            self._rounds = None

    async def _every_round(self, job: Job) -> None:
        """Update the session's state and the pages every `ROUND_S` (s); an error ends the session."""
        try:
            while True:
                if self._seat is not None:
                    self._seat.look(time.monotonic())
                    self._update_pages()
                await asyncio.sleep(ROUND_S)
        except Exception as error:
            self._shared.report_trouble(defect("the session's desk failed, and the session ends", error))
            await job.close()

    def _update_pages(self) -> None:
        for pages, message in self._messages():
            if message != self._sent.get(message["say"]):
                self._sent[message["say"]] = message
                for client in pages:
                    client.put_newest(message)

    def _messages(self) -> list[tuple[set[Client], dict[str, Any]]]:
        """Return the two messages with the session's state, for operators' pages and for participants' screens."""
        runs, seat = self._job is not None, self._seat
        desk: dict[str, Any] = {
            "say": "session",
            "runs": runs,
            "compiling": self._compiling,
            "end": self._end,
        }
        participant: dict[str, Any] = {"say": "participant", "runs": runs}
        if seat is not None:
            desk |= self._desk(seat)
            participant |= _participant(seat)
        return [(self._shared.clients, desk), (self._shared.participants, participant)]

    def _desk(self, seat: Seat) -> dict[str, Any]:
        talk, view, now_s = seat.talk, seat.talk.view, time.monotonic()
        asks = self._job is not None and self._job.asks
        later = [(talk.keymap.key_of(one), one) for one in LATER] if asks and talk.question is None else []
        return {
            "asked": talk.asked,
            "place": words.place(view),
            "state": words.state(talk),
            "saying": view.say,
            "moving": talk.moving,
            "question": words.question(talk, now_s),
            "offered": words.list_offered(talk) or later,
            "entry": None if talk.entry is None else talk.entry.purpose,
            "item": _item(talk),
            "notice": talk.notice,
            "facts": words.facts(view),
            "heat": view.heat,
            "gauges": [(one.name, one.share, one.text) for one in words.gauges(view, seat.snapshot)],
            "last": view.last,
            "lines": [line for line in view.lines if line != view.last],
            "help": talk.help,
            "keys": words.help_pairs(talk, interrupts=False),
            "hand": words.hand(talk),
            "way": None if seat.hand is None else [seat.hand.pointer.share, START_SHARE, WALL_SHARE],
            "drags": talk.hand == "mouse",
            "rings": self._rings if talk.keymap.bell else 0,
        }

    async def close(self) -> None:
        """Stop updating the pages, and cancel the tasks of this service."""
        self._leave()
        await super().close()


def _send(job: Job, kind: str, **content: Any) -> None:
    job.answer({"kind": kind, **content})


def _item(talk: Conversation) -> Mapping[str, Any] | None:
    return talk.question.item if talk.question is not None and talk.question.kind == "item" else None


def _participant(seat: Seat) -> dict[str, Any]:
    talk, view = seat.talk, seat.talk.view
    verdict = talk.question is not None and talk.question.kind == "verdict"
    item = _item(talk)
    cue, text = instruct(view)
    return {
        "asked": talk.asked,
        "cue": cue,
        "saying": text,
        "moves": view.state in MOVING,
        "left_s": math.ceil(talk.left_s(time.monotonic())),
        "verdicts": talk.keymap.verdicts if verdict else [],
        "item": item,
        "notice": talk.notice if item is not None or verdict else "",
    }
