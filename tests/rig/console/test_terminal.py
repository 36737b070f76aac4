"""What the person at the rig is shown, and what counts as their answer."""

from __future__ import annotations

import asyncio
import os
import pty
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from rig.console import requests as asked
from rig.console.client import Client
from rig.console.jobs import Jobs
from rig.console.lease import Lease
from rig.console.live import Live
from rig.console.service import Shared
from rig.console.terminal import LONGEST, Terminal
from rig.core.errors import ConfigError
from rig.realtime.hand import SharedHand
from tests.conformance.console import served
from tests.rig.console.console_fakes import Page

REAL = "serial:///dev/ttyACM0"


def at_a_terminal(monkeypatch: pytest.MonkeyPatch, body: Callable[[Terminal, int], Awaitable[None]]) -> None:
    """Run with a terminal, whose person types into the descriptor."""
    person, ours = pty.openpty()
    try:
        with open(ours, encoding="utf-8", closefd=False) as stdin, monkeypatch.context() as patched:
            patched.setattr(sys, "stdin", stdin)

            async def whole() -> None:
                async with asyncio.timeout(30):
                    await body(Terminal(), person)

            asyncio.run(whole())
    finally:
        os.close(person)
        os.close(ours)


async def asks(terminal: Terminal, text: str) -> asyncio.Task[bool]:
    task = asyncio.create_task(terminal.consents(text))
    await asyncio.sleep(0)
    return task


def test_the_word_lets_it_be_armed_and_nothing_else_does(monkeypatch: pytest.MonkeyPatch) -> None:
    async def body(terminal: Terminal, person: int) -> None:
        for typed, lets in ((b"arm\n", True), (b"\n", False), (b"army\n", False), (b"ar\x04", False)):
            answer = await asks(terminal, "it")
            os.write(person, typed)
            assert await answer == lets, typed

    at_a_terminal(monkeypatch, body)


def test_what_was_typed_before_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    async def body(terminal: Terminal, person: int) -> None:
        os.write(person, b"arm\narm\n")
        await asyncio.sleep(0.05)
        answer = await asks(terminal, "another rig")
        await asyncio.sleep(0.05)
        assert not answer.done()
        assert not await terminal.consents("a third one, meanwhile")
        os.write(person, b"\n")
        assert not await answer

    at_a_terminal(monkeypatch, body)


def test_a_terminal_obeys_no_page(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def body(terminal: Terminal, person: int) -> None:
        answer = await asks(terminal, "serial:///é\x1b[2J\r\nrig: all is well\x9b\u202e")
        terminal.withdraw()
        assert not await answer
        assert not await terminal.consents("x" * (LONGEST + 1))

    at_a_terminal(monkeypatch, body)
    shown = capsys.readouterr().out
    assert "serial:///é�[2J��rig: all is well��\nrig: is everybody clear" in shown
    assert "xxx" not in shown


@pytest.mark.parametrize("event", ["stop", "gone", "another"])
def test_a_word_arms_nothing_for_a_page_that_stopped_or_went(
    event: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body(terminal: Terminal, person: int) -> None:
        page = Page()
        shared = Shared(set(), Lease(), Jobs(lambda *_: None), tmp_path)
        with SharedHand.create(tmp_path / "hand") as hand:
            live = Live(shared, hand, terminal, verified=False, own=True)
            _, run = live.handlers()["run"]
            wanted = asyncio.ensure_future(run(_client(page), asked.Run(do="run", job="hit", url=REAL)))
            await asyncio.sleep(0)
            if event == "stop":
                live.stop_all()
            elif event == "another":
                shared.lease.release(page.name)
                shared.lease.take("another-page")
                os.write(person, b"arm\n")
            else:
                shared.lease.release(page.name)
                beats = asyncio.create_task(live.every_beat())
                await asyncio.sleep(0)
                beats.cancel()
            with pytest.raises(ConfigError, match=r"real rig|another page operates"):
                await wanted
            assert shared.jobs.running is None

    at_a_terminal(monkeypatch, body)


def test_a_console_ends_though_it_waits_for_a_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body(terminal: Terminal, person: int) -> None:
        async with served(tmp_path, terminal) as console, console.page() as page:
            await page.say("run", job="hit", url=REAL)
            while terminal._asked is None:
                await asyncio.sleep(0.01)

    at_a_terminal(monkeypatch, body)


def _client(page: Page) -> Client:
    return page  # type: ignore[return-value]
