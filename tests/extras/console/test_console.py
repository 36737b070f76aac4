"""Runs of a page in real time on the simulated rig end at zero effort when the page or the console disappears."""

import asyncio
import json
import os
import signal
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection

from rig.core.sample import Phase
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from tests.conformance.console import Page, Served, served
from tests.conformance.started import started

BEAT_S = 0.1
NAME = "the-first-page"


@asynccontextmanager
async def send_beats(hold: ClientConnection) -> AsyncIterator[None]:

    async def beat() -> None:
        while True:
            await hold.send('{"beat":true}')
            await asyncio.sleep(BEAT_S)

    task = asyncio.create_task(beat())
    try:
        yield
    finally:
        task.cancel()


async def drag_into_wall(page: Page) -> None:
    """Start a run and drag the handle slightly into the wall."""
    answer = await page.ask("run", job="play", duration_s=30)
    assert "result" in answer, answer
    await page.until(lambda page: phase(page) == "trial")
    while phase(page) == "trial" and not inside(page):
        await page.say("hand", position=0.01, press=1.0)
        await asyncio.sleep(0.04)


def inside(page: Page) -> bool:
    """Return True if the newest position of the handle is in the wall."""
    message = page.newest("hand")
    return message is not None and message["motions"][-1][2] > 0.0


async def over(page: Page) -> None:
    await page.until(lambda page: (page.newest("state") or {"job": 1})["job"] is None)


def phase(page: Page) -> str:
    state = page.newest("state")
    loop = None if state is None else state["loop"]
    failed = [one["told"] for one in page.messages if one["say"] == "job" and one["told"]["say"] == "failed"]
    if failed:
        pytest.fail(f"the run did not begin: {failed[0]}")
    return "" if loop is None or loop["ended"] else str(loop["phase"])


def wait_for_recording(place: Path) -> Recording:
    """Return the recording of a run that has ended, as soon as it is sealed."""
    deadline = time.monotonic() + 30.0
    while not (found := list(place.glob("*.parquet"))):
        assert time.monotonic() < deadline, f"nothing was sealed: {list(place.iterdir())}"
        time.sleep(0.05)
    return open_recording(found[0])


def check_zero(recording: Recording, reason: str) -> None:
    """Require an end in the trial with this reason and an error; tests of the loop check its zero effort."""
    assert recording.trailer["reason"] == reason
    assert recording.rows["phase"][-1] == Phase.TRIAL
    assert recording.trailer["error"]


@pytest.mark.quiet
def test_a_page_that_goes_ends_what_it_moves(tmp_path: Path) -> None:
    async def scenario(console: Served) -> tuple[dict[str, Any], dict[str, Any]]:
        async with console.hold(NAME) as hold, send_beats(hold), console.page(NAME) as page:
            await drag_into_wall(page)
            changed = await page.ask("set", changes={"wall.damping": 0.25})
            state: dict[str, Any] = page.newest("state") or {}
        async with console.page("another-page") as page:  # closed: no beat comes any more
            await over(page)
        return changed, state

    async def whole() -> tuple[dict[str, Any], dict[str, Any]]:
        async with asyncio.timeout(100), served(tmp_path, own=True) as console:
            return await scenario(console)

    changed, state = asyncio.run(whole())
    recording = wait_for_recording(tmp_path)
    check_zero(recording, "stopped")  # first: a run that lost its device took no change
    assert changed["result"]["number"] == 1
    assert state["operates"]
    assert recording.rows["penetration"].max() > 0.0, "the hand was in the wall"


@pytest.mark.quiet
def test_an_automated_hit_may_outlive_its_page(tmp_path: Path) -> None:
    async def whole() -> None:
        async with asyncio.timeout(100), served(tmp_path, own=True) as console:
            async with console.hold(NAME) as hold, send_beats(hold), console.page(NAME) as page:
                assert "result" in await page.ask("run", job="hit", is_detached=True)
                try:
                    await page.until(lambda page: phase(page) in ("homing", "settle", "trial"))
                except BaseException:  # too busy, too: no console ends this run
                    await over(page)
                    raise
            async with console.page("another-page") as page:
                await over(page)

    asyncio.run(whole())
    assert wait_for_recording(tmp_path).trailer["reason"] == "finished"


@pytest.mark.quiet
def test_a_killed_console_leaves_nothing_that_moves(tmp_path: Path) -> None:
    command = (sys.executable, "-P", "-m", "rig", "console", "--own", "--json", "-o", tmp_path)
    with started(*command, text=True, stdout=-1, env={**os.environ, "PYTHONPATH": os.getcwd()}) as process:
        assert process.stdout is not None
        console = Served(json.loads(process.stdout.readline())["url"])

        async def whole() -> None:
            async with (
                asyncio.timeout(100),
                console.hold(NAME) as hold,
                send_beats(hold),
                console.page(NAME) as page,
            ):
                await drag_into_wall(page)
                process.send_signal(signal.SIGKILL)
                await page.socket.wait_closed()

        asyncio.run(whole())
    check_zero(wait_for_recording(tmp_path), "stopped")
