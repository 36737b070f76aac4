"""A console and its page in Debian's Chromium, driven by playwright; without either the tests here skip."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.conformance.started import started

ROOT = Path(__file__).parents[2]
CHROMIUM = shutil.which("chromium")
PATIENCE_MS = 60_000  # a first run compiles


@pytest.fixture
def console_page(tmp_path: Path) -> Iterator[Any]:
    """The page of a console whose directory is `tmp_path`; what the page finds wrong with itself fails the test."""
    if CHROMIUM is None:
        pytest.skip("no browser: install chromium")
    api = pytest.importorskip("playwright.sync_api", reason="no playwright")
    wrong: list[str] = []
    command = (sys.executable, "-P", "-m", "rig", "console", "--own", "--json")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with (
        started(*command, cwd=tmp_path, text=True, stdout=-1, env=environment) as process,
        api.sync_playwright() as playwright,
    ):
        assert process.stdout is not None
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(json.loads(process.stdout.readline())["url"])
        yield page
        browser.close()
        process.terminate()
        process.wait(30.0)  # it ends what it started
    assert not wrong
