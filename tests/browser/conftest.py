"""A console of its own and a page on it, in Debian's Chromium."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = Path("/usr/bin/chromium")


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, by the Python registry's playwright."""
    if not CHROMIUM.exists():
        pytest.skip("chromium")
    sync_api = pytest.importorskip("playwright.sync_api", reason="chromium")
    with sync_api.sync_playwright() as playwright:
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
        chromium = playwright.chromium.launch(executable_path=str(CHROMIUM), args=arguments)
        yield chromium
        chromium.close()


@pytest.fixture
def console_page(browser: Any, tmp_path: Path) -> Iterator[Any]:
    """A page of a console whose recordings go to ``tmp_path / "recordings"``; what its scripts raise fails the test."""
    command = [
        sys.executable,
        "-P",
        "-m",
        "rig",
        "console",
        "--own",
        "--json",
        "-o",
        str(tmp_path / "recordings"),
    ]
    console = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert console.stdout is not None
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    raised: list[str] = []
    page.on("pageerror", lambda error: raised.append(str(error)))
    page.on(
        "console", lambda said: raised.append(said.text) if "Content Security Policy" in said.text else None
    )
    try:
        page.goto(json.loads(console.stdout.readline())["url"])
        yield page
    finally:
        page.close()
        console.terminate()
        console.wait(30)
        console.stdout.close()
    assert raised == []
