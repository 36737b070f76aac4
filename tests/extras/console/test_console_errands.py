"""Errands run in their own processes: results and errors are returned, and no process remains."""

import asyncio
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from rig.core.errors import RigError
from rig.extras.console import errands as sent
from rig.extras.console.errands import Errands


async def test_answers_and_errors_come_back_from_one_process_and_none_is_left(tmp_path: Path) -> None:
    errands = Errands()
    try:
        asked = {"directory": str(tmp_path), "search": "", "first": 0}
        assert await errands.run("recordings", **asked) == ({"recordings": [], "more": False}, b"")
        with pytest.raises(RigError, match="'exe' is not an export format"):
            await errands.run("export", path="nowhere", form="exe")
        (process,) = errands._all
        os.kill(process.pid, 9)
        with pytest.raises(RigError, match="the background process for 'recordings' ended"):
            await errands.run("recordings", **asked)
        assert (errands._idle, errands._all) == ([], set())  # the next one gets another
    finally:
        await errands.close()
    assert process.returncode is not None


async def test_a_reply_that_is_too_long_is_an_error_and_ends_its_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sent, "LINE_BYTES", 10)
    start = asyncio.create_subprocess_exec

    async def writes_much(*_: str, **options: Any) -> Any:
        return await start(sys.executable, "-S", "-c", "print(10**6 * 'x'); input()", **options)

    monkeypatch.setattr(asyncio, "create_subprocess_exec", writes_much)

    errands = Errands()
    try:
        with pytest.raises(RigError, match="'recordings' is longer than 10 bytes"):
            await errands.run("recordings", directory=str(tmp_path), search="", first=0)
        assert errands._all == set()
    finally:
        await errands.close()
