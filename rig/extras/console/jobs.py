"""Background jobs of a console (runs, sessions, maps): one at a time, each in a process that ends with the console.

The server starts and stops jobs here. A control loop must not run in this process.
"""

import asyncio
import json
import signal
import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from rig.core.child import with_this_package
from rig.core.errors import ConfigError, RigError, StoppedError
from rig.realtime.running import ask_to_stop

# Longest time that a job may take to complete its recording after the request to end.
END_S = 10.0
TAIL_BYTES = 4096
LINE_BYTES = 1 << 24  # largest message: a result with all its numbers


class Job:
    """A running job (a run, a session or a map) and its process.

    Attributes
    ----------
    name, content
        Name of the job, a key of `rig.extras.console.worker.JOBS`, and its arguments.
    is_detached
        True if the job continues after its operator has left.
    asks
        True if the job asks the operator after a STOP how to continue, instead of ending.
    """

    def __init__(
        self,
        name: str,
        content: Mapping[str, Any],
        process: asyncio.subprocess.Process,
        *,
        is_detached: bool,
        asks: bool = False,
    ) -> None:
        self.name, self.content, self.is_detached, self.asks = name, content, is_detached, asks
        self._process = process
        self._interrupted = False
        # Read from the start: a full pipe stops its writer.
        self._last_error_line = asyncio.create_task(self._read_last_error_line())

    @property
    def pid(self) -> int:
        """Id of the job's process, which runs its control loops."""
        return self._process.pid

    def end(self) -> None:
        """Stop the control loops of the job, or interrupt the job if no loop runs yet. Never waits.

        A session, which must ask its operator how to continue, receives a stop message instead of the interrupt.
        """
        loops = ask_to_stop(self.pid)
        if self.asks:
            self.answer({"kind": "stop"})
        elif loops == 0:
            self._interrupted = True
            with suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGINT)

    def answer(self, value: Any) -> None:
        """Send a message, such as the operator's answer to a question, to the job's standard input."""
        assert self._process.stdin is not None
        if not self._process.stdin.is_closing():
            self._process.stdin.write(json.dumps(value).encode() + b"\n")

    def beat(self) -> None:
        """Send a heartbeat to the job's process, so that it does not end because the console seems to hang."""
        if self._process.stdin is not None and self._process.stdin.transport.get_write_buffer_size() == 0:
            self._process.stdin.write(b"\n")

    async def follow(self, tell: Callable[[Mapping[str, Any]], None]) -> int:
        """Call `tell` with each message of the job until its process has ended; return the exit code."""
        assert self._process.stdout is not None
        has_ended = False
        async for line in self._process.stdout:
            if (message := _message(line)) is not None:
                has_ended |= message["say"] in ("done", "failed")
                tell(message)
        code = await self._process.wait()
        if not has_ended:
            why = await self._last_error_line
            # An interrupt during the imports ends Python without a message.
            if self._interrupted and code in (-signal.SIGINT, 1, 130):
                error: RigError = StoppedError("stopped before anything moved")
            else:
                error = RigError(f"the process of the {self.name} ended with exit code {code}", remedy=why)
            tell({"say": "failed", **error.as_mapping()})
        return code

    async def close(self) -> None:
        """End the job; kill its process if it has not ended after `END_S` (s)."""
        if self._process.returncode is None:
            self.end()
            if self.asks and self._process.stdin is not None:
                # A closed input means to the job that no answer will arrive.
                self._process.stdin.close()
            try:
                async with asyncio.timeout(END_S):
                    await self._process.wait()
            except TimeoutError:
                self._process.kill()
                await self._process.wait()

    async def _read_last_error_line(self) -> str:
        assert self._process.stderr is not None
        kept = b""
        while data := await self._process.stderr.read(TAIL_BYTES):
            kept = (kept + data)[-TAIL_BYTES:]
        lines = kept.decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it printed no reason; see the console's terminal"


def _message(line: bytes) -> dict[str, Any] | None:
    """Return the message in a line of the job's output; None if the line is other output, such as a library's."""
    try:
        found = json.loads(line)
    # Lists within lists, a few kilobytes of brackets, exhaust the parser's recursion.
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and isinstance(found.get("say"), str) else None


class Jobs:
    """Starter of background jobs (runs, sessions, maps); only one job runs at a time.

    `tell` is called with the job and each of its messages; the last message reports its end.
    """

    def __init__(self, tell: Callable[[Job, Mapping[str, Any]], None]) -> None:
        self._tell = tell
        self._task: asyncio.Task[None] | None = None
        self._starts = ""  # name of a job whose process is being started
        self._stops = 0
        self._closed = False
        self.running: Job | None = None

    async def start(
        self, name: str, content: Mapping[str, Any], *, is_detached: bool = False, asks: bool = False
    ) -> Job:
        """Start a process for the job `name`, one of `rig.extras.console.worker.JOBS`, with the arguments `content`.

        `is_detached`: the job continues without its operator. `asks`: after a STOP it asks how to continue. Raise
        `ConfigError` if another job runs or the console is shutting down, `RigError` if the process cannot be started.
        """
        busy = self._starts if self.running is None else self.running.name
        if busy:
            raise ConfigError(
                f"a {busy} is running, and only one job can run at a time", remedy=f"stop the {busy} first"
            )
        if self._closed:
            raise ConfigError("the console is shutting down", remedy="start it again: rig console")
        self._starts, stops = name, self._stops
        try:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-P", "-m", "rig.extras.console", "job"),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                limit=LINE_BYTES,
                env=with_this_package(),
                # In a session of its own, Ctrl-C on the terminal reaches only the console.
                start_new_session=True,
            )
        except OSError as error:
            raise RigError(
                f"cannot start a process for a {name}: {error.strerror}", remedy="free some memory"
            ) from error
        finally:
            self._starts = ""
        job = self.running = Job(name, content, process, is_detached=is_detached, asks=asks)
        job.answer({"job": name, "content": content, "is_detached": is_detached})
        self._task = asyncio.create_task(self._follow(job))
        if stops != self._stops:
            job.end()
        return job

    def end(self) -> None:
        """End the running job, also if its process is just being started: stop its control loops, or interrupt it."""
        self._stops += 1
        if self.running is not None:
            self.running.end()

    def beat(self) -> None:
        """Send a heartbeat to the process of the running job, which ends without heartbeats."""
        if self.running is not None:
            self.running.beat()

    async def close(self) -> None:
        """End the running job, unless it is detached, and refuse to start further jobs."""
        self._closed = True
        self._stops += 1
        if self.running is not None and not self.running.is_detached:
            await self.running.close()
            if self._task is not None:
                await self._task

    async def _follow(self, job: Job) -> None:
        try:
            await job.follow(lambda message: self._tell(job, message))
        except Exception as error:
            # A job whose messages are not read must not move a rig.
            traceback.print_exception(error)
            failure = RigError(
                f"the {job.name} could not be followed: {error!r}", remedy="report this defect"
            )
            self._tell(job, {"say": "failed", **failure.as_mapping()})
            await job.close()
        finally:
            self.running = None
            self._tell(job, {"say": "ended"})
