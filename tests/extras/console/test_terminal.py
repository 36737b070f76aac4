"""The prompts to the operator at the rig's terminal, and the inputs that count as a reply."""

import asyncio
import os
import pty
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rig.core.errors import ConfigError, PlanError
from rig.extras.console import consent, hits, session_desk
from rig.extras.console.errands import Errands
from rig.extras.console.jobs import Jobs
from rig.extras.console.lease import Lease
from rig.extras.console.live import Live
from rig.extras.console.runs import Runs
from rig.extras.console.service import ServiceContext
from rig.extras.console.session_requests import BeginSession
from rig.extras.console.talk import Talk
from rig.extras.console.terminal import LONGEST, Terminal
from rig.realtime.hand import SharedHand
from rig.session.planning._template_files import write_template
from tests.conformance.console import served, stop_of_this_test
from tests.conformance.gated import REFUSED, SLOW_S, open_as_real
from tests.extras.console.console_fakes import CONTENT, Here, Page, ask
from tests.rig.session.session_fakes import FakeRunner

REAL = "serial:///dev/ttyACM0"


@asynccontextmanager
async def at_terminal(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[tuple[Terminal, int]]:
    """Yield a terminal and the descriptor for its operator's input."""
    person, ours = pty.openpty()
    try:
        with open(ours, encoding="utf-8", closefd=False) as stdin, monkeypatch.context() as patched:
            patched.setattr(sys, "stdin", stdin)
            yield Terminal(), person
    finally:
        os.close(person)
        os.close(ours)


async def agrees(terminal: Terminal, *lines: str) -> bool:
    results = await asyncio.gather(terminal.insist(REAL, lines), return_exceptions=True)
    assert results == [None] or "arm was not typed at the console's terminal" in str(results[0])
    return results == [None]


async def asks(terminal: Terminal, *lines: str) -> asyncio.Task[bool]:
    task = asyncio.create_task(agrees(terminal, *lines))
    while terminal._asked is None:
        await asyncio.sleep(0)
    return task


async def test_the_word_lets_it_be_armed_and_nothing_else_does(monkeypatch: pytest.MonkeyPatch) -> None:
    async with at_terminal(monkeypatch) as (terminal, person):
        for typed, lets in ((b"arm\n", True), (b"\n", False), (b"army\n", False), (b"ar\x04", False)):
            answer = await asks(terminal, "it")
            os.write(person, typed)
            assert await answer == lets, typed


async def test_a_word_typed_before_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    async with at_terminal(monkeypatch) as (terminal, person):
        os.write(person, b"arm\narm\n")
        await asyncio.sleep(0.05)
        answer = await asks(terminal, "another rig")
        await asyncio.sleep(0.05)
        assert not answer.done()
        with pytest.raises(
            ConfigError, match="is waiting for the answer to another question; answer that question first"
        ):
            await terminal.insist(REAL, ["a third one, meanwhile"])
        os.write(person, b"\n")
        assert not await answer


async def test_a_terminal_obeys_no_page(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    async with at_terminal(monkeypatch) as (terminal, _):
        answer = await asks(terminal, "serial:///é\x1b[2J\r\nrig: all is well\x9b\u202e", "and more\n")
        terminal.withdraw()
        assert not await answer
        with pytest.raises(ConfigError, match="more than 2000 characters"):
            await terminal.insist(REAL, ["x" * LONGEST, "y"])
    shown = capsys.readouterr().out
    assert "serial:///é�[2J��rig: all is well��\nrig:   and more�\nrig: are all hands clear" in shown
    assert "xxx" not in shown


@pytest.mark.parametrize("event", ["stop", "gone", "another"])
async def test_a_word_arms_nothing_for_a_page_that_stopped_or_went(
    event: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with at_terminal(monkeypatch) as (terminal, person):
        page = Page()
        shared = ServiceContext(set(), Lease(), Jobs(lambda *_: None), tmp_path, Here())
        with SharedHand.create(tmp_path / "hand") as hand:
            live = Live(shared, hand, terminal, own=True)
            runs = Runs(shared, live, hand, terminal, verified=True)
            wanted = asyncio.create_task(ask(runs, page, "run", job="hit", url=REAL))
            while terminal._asked is None:
                await asyncio.sleep(0.001)
            if event == "stop":
                monkeypatch.setattr("rig.extras.console.live.ask_to_stop", stop_of_this_test)
                live.stop_all()
            elif event == "another":
                shared.lease.release(page.name)
                shared.lease.take("another-page")
                os.write(person, b"arm\n")
            else:
                shared.lease.release(page.name)
                beats = asyncio.create_task(runs.every_beat())
                await asyncio.sleep(0)
                beats.cancel()
            with pytest.raises(ConfigError, match=r"real rig|another page operates"):
                await wanted
            assert shared.jobs.running is None


async def test_terminal_and_page_show_what_is_agreed_to_and_nothing_else_is_armed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """Both show the rig, its changes, the duration, if it continues without a page, and the same digest."""

    async with at_terminal(monkeypatch) as (terminal, person):
        page, started = Page(), list[dict[str, Any]]()

        class Starts(Jobs):
            async def start(self, name: str, content: Any, **_: Any) -> Any:
                started.append(dict(content))
                return SimpleNamespace(pid=1)

        shared = ServiceContext(set(), Lease(), Starts(lambda *_: None), tmp_path, Here())
        with SharedHand.create(tmp_path / "hand") as hand:
            live = Live(shared, hand, terminal, own=True)
            runs = Runs(shared, live, hand, terminal, verified=True)
            wanted = {"job": "hit", "url": REAL, "changes": {"wall.stiffness": 55}, "is_detached": True}
            running = asyncio.create_task(ask(runs, page, "run", **wanted))
            while terminal._asked is None:
                await asyncio.sleep(0.001)
            (consent_message,) = page.messages
            os.write(person, b"arm\n")
            await running
        assert page.messages[-1] == {"say": "consent", "lines": None}
        shown = capsys.readouterr().out
        for line in consent_message["lines"]:
            assert line in shown
        text = "\n".join(consent_message["lines"])
        for part in (REAL, "koul-compliant", "wall.stiffness = 55", " s at most", "continues to its end"):
            assert part in text
        (content,) = started
        assert f"experiment {content['digest']}" in text
        with pytest.raises(ConfigError, match="has changed since the operator agreed to it"):
            hits.hit({**content, "changes": {"wall.stiffness": 56}}, Talk(is_detached=False))


def test_a_resumed_session_has_its_first_digest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_template("first-steps", tmp_path / "mine.toml")
    monkeypatch.setattr(session_desk, "DeviceRunner", lambda **_: FakeRunner())
    talk = Talk(is_detached=False)
    monkeypatch.setattr(talk, "tell", lambda say, **content: None)
    monkeypatch.setattr(talk, "hear", lambda _: {"kind": "reply", "number": 1, "action": "abort"})
    session_desk.session(CONTENT, talk)
    (log,) = tmp_path.glob("sessions/*/P01/session.log")
    agreed = session_desk.digest_of("mine.toml", "")
    assert session_desk.digest_of("", str(log.parent)) == agreed
    text = (tmp_path / "mine.toml").read_text()
    (tmp_path / "mine.toml").write_text(text.replace("seed = ", "seed = 1"))
    with pytest.raises(ConfigError, match="has changed since the operator agreed to it"):
        session_desk.session({**CONTENT, "digest": agreed}, talk)


def test_the_operator_agrees_to_each_exception_of_a_session() -> None:
    begun = BeginSession(do="session", protocol="a.toml", code="P01", arm_anyway=True, lossy_anyway=True)
    lines = consent.describe_session(begun, REAL, "1234 5678")
    assert lines[0] == f"{REAL} for the session of P01 with a.toml"
    assert "refuses, a computer or link that loses samples" in lines[1]
    assert "another device" not in lines[1]
    resumed = BeginSession(do="session", directory="sessions/a/P01", at="block", other_device=True)
    lines = consent.describe_session(resumed, REAL, "1234 5678")
    assert "sessions/a/P01, resumed at the block" in lines[0]
    assert lines[1] == "consents to: another device than before"


async def test_a_console_that_waits_for_a_word_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Errands, "run", Here.run)
    monkeypatch.setattr("rig.extras.console.lease.LOST_S", 1e9)  # this page sends no beats

    async with (
        at_terminal(monkeypatch) as (terminal, _),
        served(tmp_path, terminal, own=True) as console,
        console.page() as page,
    ):
        await page.say("run", job="hit", url=REAL)
        while terminal._asked is None:
            await asyncio.sleep(0.01)
        assert "result" in await page.ask("operate", take=True), "requests are served meanwhile"


def test_a_page_asks_the_gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    open_as_real(monkeypatch, SLOW_S)
    changes = {"host.realtime": "off", "trial.minimum_rest_counts": 0.0}
    content = {"url": "serial:///dev/rig", "verified": True, "output": str(tmp_path), "changes": changes}
    with pytest.raises(PlanError, match=REFUSED):
        hits.hit(content, Talk(is_detached=False))
