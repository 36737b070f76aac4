"""The sessions' view of the console: which page's keys count, what each page shows, and what the live view hides."""

import asyncio
import inspect
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, cast

import pytest

from rig.core.errors import ConfigError, StoppedError
from rig.extras.console import session_desk, session_lists
from rig.extras.console.client import Client
from rig.extras.console.errand_worker import ERRANDS
from rig.extras.console.jobs import Job, Jobs
from rig.extras.console.lease import Lease
from rig.extras.console.live import Live
from rig.extras.console.service import ServiceContext
from rig.extras.console.session_lists import protocols, resumable
from rig.extras.console.talk import Talk
from rig.extras.console.terminal import Terminal
from rig.realtime import control_words
from rig.realtime.control_words import STOP
from rig.realtime.hand import SharedHand
from rig.realtime.ring import Ring
from rig.session.engine import _conduct
from rig.session.engine._desk import DeskView, Question, Reply
from rig.session.engine._place import Place
from rig.session.planning._protocol import Keys
from rig.session.planning._template_files import template_names, write_template
from rig.session.terminal._participant import INSTRUCTIONS, instruct
from tests.conformance.started import WAIT_S
from tests.extras.console.console_fakes import CONTENT
from tests.rig.session.session_desks import AtPage, FakeClient, until
from tests.rig.session.session_fakes import FakeRunner

VERDICT = Question(kind="verdict", text="the verdict?", actions=("judge", "redo", "note", "abort"), trial=3)
READY = Question(kind="ready", text="ready?", actions=("go", "pause", "note", "abort"))
ITEM = Question(
    kind="item",
    text="How tired?",
    actions=("answer", "note", "abort"),
    item={"name": "tired", "text": "How tired?", "kind": "text", "lowest": 1, "highest": 7, "choices": []},
)


@pytest.fixture
def asker() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as one:
        yield one


@pytest.fixture
def page(asker: ThreadPoolExecutor) -> Iterator[AtPage]:
    one = AtPage(Keys(), None, 20.0)
    yield one
    one.leave()
    one.close()


def asked(page: AtPage, asker: ThreadPoolExecutor, question: Question) -> Future[Reply]:
    reply = asker.submit(page.desk.ask, question)
    page.sees(question.text)
    return reply


def test_a_key_about_an_earlier_question_is_no_answer(page: AtPage, asker: ThreadPoolExecutor) -> None:
    reply = asked(page, asker, READY)
    before = page.session["asked"]
    page.press("g")
    assert reply.result(WAIT_S).action == "go"
    reply = asked(page, asker, VERDICT)
    page.ask("session_key", key="1", asked=before)  # pressed before the verdict could be read
    page.ask("session_line", text="1", asked=before)
    page.ask("session_key", key="3", asked=before + 1)
    assert reply.result(WAIT_S).value == "unstable"


def test_the_time_of_an_answer_is_from_when_it_could_be_read(page: AtPage, asker: ThreadPoolExecutor) -> None:
    reply = asked(page, asker, VERDICT)
    page.ask("session_key", key="1", asked=page.session["asked"], shown_s=0.0)
    assert reply.result(WAIT_S).took_s == 0.0
    reply = asked(page, asker, VERDICT)
    page.ask("session_key", key="2", asked=page.session["asked"], shown_s=1e6)  # longer than it was asked
    assert reply.result(WAIT_S).took_s < WAIT_S


def test_a_page_that_comes_back_sees_the_question(page: AtPage, asker: ThreadPoolExecutor) -> None:
    page.desk.show(DeskView(state="verdict?", code="P08"))
    reply = asked(page, asker, VERDICT)
    again = FakeClient("operator, reloaded")
    page.service.greet(cast("Client", again))
    assert again.newest["session"] == page.session
    assert again.newest["session"]["question"] == "the verdict?"
    page.shared.lease.release("operator")
    page.ask("session_key", again, key="1", asked=again.newest["session"]["asked"])
    assert reply.result(WAIT_S).value == "stable"


def test_a_desk_that_cannot_look_reports_it_and_ends(page: AtPage, asker: ThreadPoolExecutor) -> None:
    reply = asked(page, asker, READY)
    assert page.service._seat is not None
    page.service._seat.look = lambda _: {}["a defect"]  # type: ignore[method-assign]
    with pytest.raises(StoppedError):  # as a question without an answer
        reply.result(WAIT_S)
    assert "a defect" in page.client.newest["trouble"]["message"]


def test_one_page_operates_and_any_may_stop(page: AtPage, asker: ThreadPoolExecutor) -> None:
    reply = asked(page, asker, READY)
    other = FakeClient("another")
    with pytest.raises(ConfigError, match="another page operates"):
        page.ask("session_key", other, key="g", asked=page.session["asked"])
    page.press("g")
    reply.result(WAIT_S)
    with Ring.allocate(16, info={}, shared=True) as ring:
        page.ask("session_key", other, key="space")
        assert ring.peek(STOP) != 0
    watch = page.desk.watch()
    assert watch is not None
    with pytest.raises(StoppedError, match="stopped at the console"):
        watch(0, 3)


def test_a_participant_answers_verdicts_and_items_alone(page: AtPage, asker: ThreadPoolExecutor) -> None:
    def answers(key: str = "", line: str = "") -> None:
        what = {"key": key} if key else {"text": line}
        do = "session_key" if key else "session_line"
        number = page.participant.newest["participant"]["asked"]
        page.ask(do, page.participant, asked=number, **what)

    reply = asked(page, asker, READY)
    for key in ("g", "enter", "p", "a", "n"):
        answers(key)
    assert page.participant.newest["participant"]["verdicts"] == []
    assert page.session["question"] == "ready?"
    page.press("g")
    assert reply.result(WAIT_S).action == "go"
    reply = asked(page, asker, VERDICT)
    for key in ("r", "a", "n", "?"):
        answers(key)
    assert page.session["offered"][0] == ["1", "stable"]
    assert [verdict for _, verdict in page.participant.newest["participant"]["verdicts"]][:2] == [
        "stable",
        "buzz",
    ]
    answers("2")
    assert reply.result(WAIT_S).value == "buzz"
    reply = asked(page, asker, ITEM)
    answers(line="not <b>very</b>")
    assert reply.result(WAIT_S).value == "not <b>very</b>"


def test_a_participant_sees_no_wall_and_no_trouble_of_an_unblinded_operator(page: AtPage) -> None:
    seen = DeskView(
        state="trouble", say="", blinded=False, condition="dual", stiffness=25.5, last="invalid: secret"
    )
    page.desk.show(seen)
    page.sees("K = 25.5")
    message = page.participant.newest["participant"]
    assert message["cue"] == "Please wait"
    assert message["saying"] == "You may let go of the handle."
    assert not {"25.5", "dual", "secret"} & set(json.dumps(message).replace('"', " ").split())
    assert instruct(DeskView(state="go", say="Push.")) == ("Go", "Push.")
    assert instruct(DeskView(state="a new one", say="invalid: K = 25.5")) == ("Please wait", "")


def test_a_participant_reads_an_instruction_in_each_state_and_no_word_of_the_operators() -> None:
    states = set(re.findall(r'self\._show\(\s*"([^"]+)"', inspect.getsource(_conduct)))
    assert set(INSTRUCTIONS) == {"starting", *states, *_conduct._PHASES.values()}
    for state in INSTRUCTIONS:
        words = set(" ".join(instruct(DeskView(state=state, say="Push."))).lower().split())
        assert not words & {"homing", "release", "verdict", "trouble"}, state
    assert instruct(DeskView(state="ready", say="Push.")) == (
        "Get ready",
        "Push. Do not move yet: wait for Go.",
    )


def test_pages_are_blind_until_a_view_says_otherwise(page: AtPage) -> None:
    assert page.shared.blinded
    page.desk.show(DeskView(state="ready"))
    page.sees("ready")
    assert page.shared.blinded
    page.desk.show(DeskView(state="open", blinded=False))
    page.sees("open")
    assert not page.shared.blinded
    page.desk.show(DeskView(state="again", blinded=True))
    page.sees("again")
    page.in_loop(page.receive({"say": "ended"}))
    assert not page.shared.blinded


class Page(FakeClient):
    def __init__(self) -> None:
        super().__init__("page")
        self.followed: Any = None
        self.put_ = ""

    def show(self, followed: Any, *more: Any, **paused: Any) -> None:
        self.followed = followed

    def put(self, message: str) -> None:
        self.put_ += message


def test_nothing_of_a_blinded_loop_reaches_a_page(tmp_path: Path) -> None:
    info = {"experiment": {"wall": {"stiffness": 1234.5}, "controller": {"position_rate": 1000}}}
    one = Page()
    shared = ServiceContext({cast("Client", one)}, Lease(), Jobs(lambda *_: None), tmp_path)
    with SharedHand.create(tmp_path / "hand") as hand, Ring.allocate(64, info=info, shared=True) as ring:
        ring.words[control_words.HEAD] = 10
        live = Live(shared, hand, Terminal(), own=False)
        live._pid = os.getpid()
        shared.blinded = True
        asyncio.run(live.search())
        live.greet(cast("Client", one))
        live._send_state()
        assert (one.followed, one.put_) == (None, "")
        assert one.newest["state"]["loop"] is None
        shared.blinded = False
        asyncio.run(live.search())
        assert "1234.5" in one.put_  # who may see it does
        live._followed.poll()  # type: ignore[union-attr]
        one.put_ = ""
        shared.blinded = True
        asyncio.run(live.search())
        live.greet(cast("Client", one))
        live._send_state()
        assert (one.followed, one.put_, live._history.rows) == (None, "", 0)
        assert one.newest["state"]["loop"] is None
        with pytest.raises(ConfigError, match="no control loop is running"):
            live.looked_at()  # nor is its wall changed


@pytest.mark.parametrize(
    "given",
    [{"protocol": "a.toml", "code": "P01", "url": "serial:///dev/ttyACM0"}, {"directory": "sessions/a/P01"}],
    ids=["begun", "resumed"],
)
def test_a_real_rig_needs_a_word_at_the_terminal(
    given: dict[str, Any], page: AtPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The word is needed even if only the log states that the rig is real."""
    before = Place(url="serial:///dev/ttyACM0", realtime=True, simulated=False)
    monkeypatch.setattr(session_lists, "took_place", lambda _: before)
    monkeypatch.setattr(session_lists, "read_person", lambda _: None)
    monkeypatch.setitem(ERRANDS, "session digest", lambda **_: "1234 5678")
    page.jobs.started = {}
    with pytest.raises(ConfigError, match="ttyACM0 is a real rig and was not armed") as caught:
        page.ask("session", **given)
    assert caught.value.remedy
    assert page.jobs.started == {}


def test_protocols_and_sessions_to_resume_are_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_template("first-steps", tmp_path / "mine.toml")
    (tmp_path / "other.toml").write_text("[study]\n")
    (tmp_path / "broken.toml").write_text("[[[")
    assert [one["name"] for one in protocols()] == ["mine.toml", *template_names()]
    monkeypatch.setattr(session_desk, "DeviceRunner", lambda **_: FakeRunner())
    sent: list[Any] = []
    talk = Talk(is_detached=False)
    monkeypatch.setattr(talk, "tell", lambda say, **content: sent.append((say, content)))
    done = session_desk.session({**CONTENT, "person": PERSON}, talk)
    assert done["stands"] == "session of P01: complete"
    assert [say for say, _ in sent[:2]] == ["setup", "view"]
    assert resumable() == []
    monkeypatch.setattr(talk, "hear", lambda _: {"kind": "reply", "number": 1, "action": "abort"})
    left = session_desk.session({**CONTENT, "code": "P02"}, talk)
    assert (left["stands"], left["over"]) == ("session of P02: interrupted: the operator left", False)
    (found,) = resumable()
    assert (found["code"], found["trials"], found["rehearsal"]) == ("P02", 0, False)
    monkeypatch.setattr(talk, "hear", lambda _: {"kind": "reply", "number": 1, "action": "abort"})
    again = session_desk.session(
        {**CONTENT, "protocol": "", "code": "", "directory": found["directory"]}, talk
    )
    assert again["stands"] == "session of P02: interrupted: the operator left"
    session_desk.session({**CONTENT, "study": "elsewhere"}, talk)
    assert (tmp_path / "elsewhere" / "P01" / "session.log").exists()


PERSON = {"thresholds": [], "spread": 15.0, "lapse_rate": 0.0, "people_sd": 0.0}


async def test_a_stop_does_not_end_a_job_that_asks_and_a_console_that_closes_does() -> None:
    """The job is a process that echoes its input, and ends with it."""
    program = "import sys; print('{\"say\": \"up\"}', flush=True); [print(x, end='', flush=True) for x in sys.stdin]"
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", program),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    job, lines = Job("session", {}, process, is_detached=False, asks=True), []
    assert process.stdout is not None
    lines.append((await process.stdout.readline()).decode())
    job.end()
    lines.append((await process.stdout.readline()).decode())
    assert process.returncode is None
    await job.close()
    assert (json.loads(lines[1]), await process.wait()) == ({"kind": "stop"}, 0)


def test_a_dragged_hand_is_of_who_operates(page: AtPage) -> None:
    with pytest.raises(ConfigError, match="another page operates"):
        page.ask("session_hand", FakeClient("another"), share=0.5)
    page.ask("session_hand", share=0.5)
    until(lambda: page.session["way"] is None, "no hand to drag where a script moves it")
