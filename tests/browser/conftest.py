"""Fixtures for pages in Chromium, driven by playwright; tests skip where either is missing, and name the package."""

import json
import os
import pty
import shutil
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.browser.cable import Cable
from tests.conformance.started import started

ROOT = Path(__file__).parents[2]
CHROMIUM = shutil.which("chromium")
SIZE = {"width": 1280, "height": 720}
PATIENCE_MS = 60_000  # a first run compiles


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A headless browser."""
    if CHROMIUM is None:
        pytest.skip("no browser: install chromium")
    api = pytest.importorskip(
        "playwright.sync_api", reason="no playwright: pip install 'haptic-rig[browser]'"
    )
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def started_console(place: Path, *options: str, **streams: Any) -> Iterator[Any]:
    """Start a console process that writes into the directory ``recordings`` of a place; its URL is `url`."""
    command = (
        *(sys.executable, "-P", "-m", "rig", "console", "--own", "--json", "-o", place / "recordings"),
        *options,
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with started(*command, cwd=place, text=True, stdout=-1, env=environment, **streams) as process:
        assert process.stdout is not None
        process.url = json.loads(process.stdout.readline())["url"]
        yield process
        process.send_signal(signal.SIGCONT)
        process.terminate()
        process.wait(30.0)  # it ends what it started


@pytest.fixture
def console(tmp_path: Path) -> Iterator[Any]:
    """A console process without a terminal."""
    with started_console(tmp_path) as process:
        yield process


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Any]:
    """A console behind a `Cable`: `url` leads through the cable, and `cut` interrupts it."""
    with Cable() as cable, started_console(tmp_path, "--allow-host", cable.name) as process:
        far = process.url.removeprefix("http://").partition("/")[0]
        cable.lead_to(int(far.rpartition(":")[2]))
        process.url, process.cut = process.url.replace(far, cable.name), cable.cut
        yield process


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[tuple[Any, int]]:
    """A console in a terminal, and the descriptor to which the operator's input is written."""
    person, ours = pty.openpty()
    try:
        with started_console(tmp_path, stdin=ours) as process:
            yield process, person
    finally:
        os.close(person)
        os.close(ours)


@pytest.fixture
def open_page(chromium: Any) -> Iterator[Any]:
    """A function that opens a page at a URL; an error in the page's scripts fails the test."""
    contexts, wrong = [], []

    def opened(url: str, **options: Any) -> Any:
        context = chromium.new_context(**{"viewport": SIZE, **options})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.goto(url)
        return page

    yield opened
    for context in contexts:
        context.close()
    unexpected = [text for text in wrong if "WebSocket" not in text]  # a server that a test kills
    assert not unexpected, unexpected


@pytest.fixture
def console_page(console: Any, open_page: Any) -> Any:
    """The page of a console."""
    return open_page(console.url)
