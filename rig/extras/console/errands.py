"""Run errands (reading, drawing and computing for a page) in other processes, so that a STOP never waits for them.

At most `MOST` processes (`rig.extras.console.errand_worker`) are started when they are needed. Each runs one errand at
a time and caches the files that it has read. The processes end with the server, also if the server is killed, because
their input ends.
"""

import asyncio
import json
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rig.core.child import with_this_package
from rig.core.errors import RigError

MOST = 2  # processes
LINE_BYTES = 1 << 26  # largest reply line


class Errands:
    """Pool of processes that read, draw and compute for a page; the server must close the pool."""

    def __init__(self) -> None:
        self._free_processes = asyncio.Semaphore(MOST)
        self._idle: list[asyncio.subprocess.Process] = []
        self._all: set[asyncio.subprocess.Process] = set()

    async def run(
        self, errand: str, *, compiling: Callable[[bool], None] = lambda busy: None, **content: Any
    ) -> tuple[Any, bytes]:
        """Read, draw or compute in another process; `errand` names the function, and `content` has its arguments.

        Return the function's result as JSON values, and its bytes (a picture or samples; may be empty). `compiling` is
        called with True when a compilation begins, and with False when it ends. Raises `RigError` if the function
        fails, its process dies, or its reply is longer than `LINE_BYTES`.
        """
        async with self._free_processes:
            process = self._idle.pop() if self._idle else await self._start()
            try:
                answer, data = await _request(process, {"errand": errand, "content": content}, compiling)
            except BaseException:
                # A cancelled process could still send its reply, which would be taken for the reply to the next errand.
                await self._end(process)
                raise
            self._idle.append(process)
        if "error" in answer:
            raise RigError(answer["error"], remedy=answer["remedy"])
        return answer["result"], data

    async def close(self) -> None:
        """Kill all processes of the pool; none has unsaved data."""
        for process in tuple(self._all):
            await self._end(process)

    async def _start(self) -> asyncio.subprocess.Process:
        try:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-P", "-m", "rig.extras.console", "errands"),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                limit=LINE_BYTES,
                env=with_this_package(),
                start_new_session=True,
            )
        except OSError as error:
            raise RigError(
                f"cannot start a background process: {error.strerror}", remedy="free some memory"
            ) from error
        self._all.add(process)
        return process

    async def _end(self, process: asyncio.subprocess.Process) -> None:
        self._all.discard(process)
        with suppress(ProcessLookupError):
            # Killing loses no data: files appear complete or not at all.
            process.kill()
        await process.wait()


async def _request(
    process: asyncio.subprocess.Process, message: dict[str, Any], compiling: Callable[[bool], None]
) -> tuple[dict[str, Any], bytes]:
    # Lines of JSON: any number of {"compiling"}, then {"result", "bytes"} or {"error", "remedy"}, then that many bytes.
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        process.stdin.write(json.dumps(message).encode() + b"\n")
        await process.stdin.drain()
        while "compiling" in (answer := json.loads(await process.stdout.readuntil(b"\n"))):
            compiling(answer["compiling"])
        return answer, await process.stdout.readexactly(answer.get("bytes", 0))
    except asyncio.LimitOverrunError as error:
        process.kill()
        await process.stdout.read()  # the pipe is paused: unread, it would keep `wait` from ever returning
        raise RigError(
            f"the reply to {message['errand']!r} is longer than {LINE_BYTES} bytes",
            remedy="request less at once: fewer recordings, or a shorter part of one",
        ) from error
    except (OSError, asyncio.IncompleteReadError) as error:
        raise RigError(
            f"the background process for {message['errand']!r} ended without a result",
            remedy="see the reason in the console's terminal",
        ) from error
