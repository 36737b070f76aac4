"""Jobs and their operator: STOP in every phase, an operator who leaves; jobs and errands with arbitrary output.

A job here is a small program in place of `rig.extras.console.worker`.
"""

import asyncio
import errno
import os
import sys
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from rig.core.errors import ConfigError, RigError
from rig.extras.console import errands as sent
from rig.extras.console.errands import Errands
from rig.extras.console.jobs import Job, Jobs
from rig.extras.console.lease import LOOK_S, Lease
from rig.extras.console.live import Live
from rig.extras.console.runs import Runs
from rig.extras.console.service import ServiceContext
from rig.extras.console.terminal import Terminal
from rig.realtime.hand import SharedHand
from tests.conformance.started import WAIT_S

WAITS = "import time; time.sleep(60)"


class Here:
    """The jobs of a test's own program, and their messages."""

    def __init__(self, program: str, monkeypatch: pytest.MonkeyPatch) -> None:
        self.messages: list[dict[str, Any]] = []
        self.jobs = Jobs(lambda job, message: self.messages.append(dict(message)))
        self.begun = asyncio.Event()
        start = asyncio.create_subprocess_exec

        async def ours(*_: str, **options: Any) -> Any:
            self.begun.set()
            return await start(sys.executable, "-c", program, **options)

        monkeypatch.setattr(asyncio, "create_subprocess_exec", ours)

    async def wait_for_end(self) -> None:
        async with asyncio.timeout(WAIT_S):
            while {"say": "ended"} not in self.messages:
                await asyncio.sleep(0.01)


@asynccontextmanager
async def jobs_of(program: str, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Here]:
    here = Here(program, monkeypatch)
    try:
        yield here
    finally:
        await here.jobs.close()


def runs(shared: ServiceContext, hand: SharedHand) -> Runs:
    terminal = Terminal()
    return Runs(shared, Live(shared, hand, terminal, own=True), hand, terminal, verified=False)


async def test_a_stop_that_comes_while_a_job_starts_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    async with jobs_of(WAITS, monkeypatch) as here:
        starting = asyncio.create_task(here.jobs.start("hit", {}))
        await here.begun.wait()
        here.jobs.end()
        await starting
        await here.wait_for_end()
        assert here.jobs.running is None


async def test_a_stop_ends_our_job_also_where_no_other_loop_can_be_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_descriptor_left() -> list[Any]:
        raise OSError(errno.EMFILE, "Too many open files")

    async with jobs_of(WAITS, monkeypatch) as here:
        monkeypatch.setattr("rig.extras.console.live.ask_to_stop", no_descriptor_left)
        await here.jobs.start("hit", {})
        with SharedHand.create(tmp_path / "hand") as hand:
            shared = ServiceContext(set(), Lease(), here.jobs, tmp_path)
            live = Live(shared, hand, Terminal(), own=True)
            with pytest.raises(OSError, match="Too many"):
                live.stop_all()
        await here.wait_for_end()


async def test_of_two_jobs_at_once_one_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    async with jobs_of(WAITS, monkeypatch) as here:
        first = asyncio.create_task(here.jobs.start("hit", {}))
        await here.begun.wait()
        with pytest.raises(ConfigError, match="a hit is running"):
            await here.jobs.start("play", {})
        job = await first
        assert here.jobs.running is job


async def test_a_job_without_an_operator_ends_unless_it_is_detached(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with jobs_of(WAITS, monkeypatch) as here:
        shared = ServiceContext(set(), Lease(), here.jobs, tmp_path)
        with SharedHand.create(tmp_path / "hand") as hand:
            beats = asyncio.create_task(runs(shared, hand).every_beat())
            shared.lease.take("a-page-here")
            await here.jobs.start("play", {})
            shared.lease.release("a-page-here")  # the page may close then
            await here.wait_for_end()
            here.messages.clear()
            going = await here.jobs.start("hit", {}, is_detached=True)
            await asyncio.sleep(3 * LOOK_S)
            assert here.jobs.running is going
            going.end()
            await here.wait_for_end()
            beats.cancel()


async def test_a_console_that_cannot_watch_ends_its_jobs_also_detached_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with jobs_of(WAITS, monkeypatch) as here:
        monkeypatch.setattr(Lease, "expire", lambda _: {}["a defect"])
        await here.jobs.start("hit", {}, is_detached=True)
        with SharedHand.create(tmp_path / "hand") as hand:
            shared = ServiceContext(set(), Lease(), here.jobs, tmp_path)
            with pytest.raises(KeyError):
                await runs(shared, hand).every_beat()
        await here.wait_for_end()


async def test_output_that_is_no_message_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    """A library may print anything on either stream; the job continues to its end."""
    noise = "print('42'); print('null'); print('[]'); print('{}'); print('{\"say\": 1}')"
    program = (
        f"import sys; {noise}; sys.stderr.write('x' * 1_000_000 + '\\nthe last word\\n');"
        'print(\'{"say": "up"}\', flush=True)'
    )

    async with jobs_of(program, monkeypatch) as here:
        await here.jobs.start("hit", {})
        await here.wait_for_end()
        up, failed, ended = here.messages
        assert (up, ended) == ({"say": "up"}, {"say": "ended"})
        assert failed["remedy"] == "the last word"


async def test_a_job_that_cannot_be_followed_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    async with jobs_of(
        'import time; print(\'{"say": "up"}\', flush=True); time.sleep(60)', monkeypatch
    ) as here:

        def tell(job: Job, message: Mapping[str, Any]) -> None:
            here.messages.append(dict(message))
            if message["say"] == "up":
                raise KeyError("a defect")

        here.jobs = Jobs(tell)
        job = await here.jobs.start("hit", {}, is_detached=True)
        await here.wait_for_end()
        assert [one["say"] for one in here.messages] == ["up", "failed", "ended"]
        assert "a defect" in here.messages[1]["error"]
        assert not Path(f"/proc/{job.pid}").exists()


IMPORTS = 'print(\'{"say": "progress"}\', flush=True)\nimport time\ntime.sleep(60)'


async def test_a_job_that_is_stopped_while_it_imports_was_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """The report has neither an exit code nor a line of a traceback, as for a job that handles the interrupt."""

    failed: list[dict[str, Any]] = []

    async with jobs_of(IMPORTS, monkeypatch) as here:
        await here.jobs.start("hit", {})
        async with asyncio.timeout(WAIT_S):
            while {"say": "progress"} not in here.messages:
                await asyncio.sleep(0.01)
        here.jobs.end()
        await here.wait_for_end()
        failed.extend(one for one in here.messages if one["say"] == "failed")
    assert [(one["kind"], one["error"]) for one in failed] == [
        ("StoppedError", "stopped before anything moved")
    ]


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


async def test_no_more_processes_than_there_is_room_for(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[object] = []

    async def start(errands: Errands) -> object:
        started.append(object())
        return started[-1]

    async def asked(process: object, message: object, compiling: object) -> object:
        await asyncio.sleep(0.01)
        return {"result": process}, b""

    monkeypatch.setattr(Errands, "_start", start)
    monkeypatch.setattr(sent, "_request", asked)

    errands = Errands()
    done = await asyncio.gather(*(errands.run("map") for _ in range(3 * sent.MOST)))
    assert {id(process) for process, _ in done} == {id(process) for process in started}
    assert len(started) == sent.MOST
