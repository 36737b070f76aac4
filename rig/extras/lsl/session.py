"""Send a session's markers to the process that streams them by LSL, without ever waiting for that process.

`rig session run --lsl` uses it. A failed stream must not end a session.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import time
from bisect import bisect_right
from contextlib import suppress
from importlib.util import find_spec
from mmap import ACCESS_READ, mmap
from tempfile import TemporaryFile
from types import TracebackType
from typing import Any

from rig.core.errors import ConfigError, RigError
from rig.core.sample import Motion

NAME = "haptic-rig"
PATIENCE_S = 5.0
READY_S = 30.0
# PIPE_BUF of Linux: a write of at most this size to a pipe is complete or fails. On macOS (512 bytes) a longer marker
# may be written in part while the pipe is nearly full.
LINE_BYTES = 4096
CUT = "…"  # what stands for the rest of a text

_log = logging.getLogger(__name__)


def marker_line(at_ns: int, content: dict[str, Any]) -> bytes:
    """Return a marker as a line of JSON of at most `LINE_BYTES`; a long `text` is cut.

    The line is longer if the rest of the content is too long.
    """

    def line(**changed: Any) -> bytes:
        line = {"at": at_ns, "marker": {**content, **changed}}
        return json.dumps(line, default=str, ensure_ascii=False).encode(errors="replace") + b"\n"

    whole, text = line(), content.get("text")
    if len(whole) <= LINE_BYTES or not isinstance(text, str):
        return whole
    fits = bisect_right(range(len(text)), LINE_BYTES, key=lambda length: len(line(text=text[:length] + CUT)))
    return line(text=text[: max(0, fits - 1)] + CUT)


def _refuse_if_missing() -> None:
    if sys.platform == "win32":
        raise ConfigError(
            "LSL markers need Linux or macOS",
            remedy="run without `lsl`: the recordings contain the events and both clocks",
        )
    elif find_spec("pylsl") is None:
        raise ConfigError("pylsl is not installed", remedy="pip install 'haptic-rig[lsl]'")


class LslMarks:
    """Context manager that runs ``rig serve lsl`` for the loops of this process, and sends markers to it.

    After its start only `wait` raises, so that a failed stream does not end a session; `wait` and `close` may block.
    `lost` counts markers that could not be sent, with one warning for each reason. A `text` that is too long is cut.
    The constructor raises `ConfigError` if pylsl is missing or the system is Windows, `RigError` if the process cannot
    be started.

    Parameters
    ----------
    name
        First word of the streams' names.
    rate
        Largest number of samples a second; None: every row.
    blind
        Remove everything about walls and conditions from the markers, also from the markers of `push`.
    expected
        Motion and position rate (Hz) of the loops to come; the stream of samples is then open when `wait` returns.
    """

    def __init__(
        self,
        *,
        name: str = NAME,
        rate: float | None = None,
        blind: bool = True,
        expected: tuple[Motion, float] | None = None,
    ) -> None:
        _refuse_if_missing()
        command = [sys.executable, "-P", "-m", "rig", "serve", "lsl", "--json", "--markers"]
        command += ["--pid", str(os.getpid()), "--name", name]
        command += [] if rate is None else ["--rate", repr(rate)]
        command += ["--blind"] if blind else []
        command += [] if expected is None else ["--open-early", expected[0], repr(expected[1])]
        self._output, self._errors = TemporaryFile(), TemporaryFile()  # noqa: SIM115  (until `close`)
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=self._output,
                stderr=self._errors,
                start_new_session=True,  # a Ctrl-C on the terminal is the session's to answer
            )
        except OSError as error:
            raise RigError(
                f"the LSL process cannot be started: {error.strerror}", remedy="free some memory"
            ) from error
        assert self._process.stdin is not None
        self._descriptor = self._process.stdin.fileno()
        if sys.platform != "win32":
            os.set_blocking(self._descriptor, False)
        self.lost = 0
        self._warned: set[str] = set()
        self._streams = 1 if expected is None else 2
        self._closed = False

    def wait(self, timeout_s: float = READY_S) -> None:
        """Wait until the streams are open, so that a recorder can find them before the first trial.

        Raises `RigError` if the process ended, or the streams did not open in time.
        """
        deadline = time.monotonic() + timeout_s
        while sum("stream" in news for news in self._news()) < self._streams:
            if self._process.poll() is not None:
                raise RigError(
                    f"LSL failed to start: {self._read_last_error_line()}",
                    remedy="run `rig serve lsl` alone to see its messages",
                )
            if time.monotonic() > deadline:
                raise RigError(
                    f"LSL has not started within {timeout_s:g} s",
                    remedy="run `rig serve lsl` alone to see its messages, or run without `lsl`",
                )
            time.sleep(0.02)

    def push(self, mark: str, at_ns: int | None = None, **content: Any) -> None:
        """Send a marker of the kind `mark` with a time on CLOCK_MONOTONIC (ns; None: now).

        A `trial` in the content is added to all markers that follow, also to the markers of the loop.
        """
        at = time.monotonic_ns() if at_ns is None else at_ns
        line = marker_line(at, {"mark": mark, **content})
        if len(line) > LINE_BYTES:
            self._count_lost(f"a marker longer than {LINE_BYTES} bytes was not sent to LSL")
            return
        try:
            if self._closed:
                raise BrokenPipeError
            os.write(self._descriptor, line)
        except OSError:
            self._count_lost("the LSL process no longer accepts markers; the session continues without them")

    def _count_lost(self, why: str) -> None:
        self.lost += 1
        if why not in self._warned:
            self._warned.add(why)
            _log.warning(why)

    def close(self) -> dict[str, Any] | None:
        """End the process after it has sent its queue; return its counts (`serve.Streamed`), or None without counts."""
        if self._closed:
            return None
        self._closed = True
        process = self._process
        assert process.stdin is not None
        with suppress(OSError):
            process.stdin.close()
        try:
            process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        with self._output, self._errors:
            if process.returncode != 0:
                _log.warning(
                    "the LSL process ended with exit code %d: %s",
                    process.returncode,
                    self._read_last_error_line(),
                )
            return next((dict(news["served"]) for news in self._news() if "served" in news), None)

    def _news(self) -> list[dict[str, Any]]:
        descriptor = self._output.fileno()
        size = os.fstat(descriptor).st_size
        if size == 0:
            return []
        # A mapping, because the process writes at the position of the same open file, which a read would move.
        with mmap(descriptor, size, access=ACCESS_READ) as content:
            lines = content[:].splitlines(keepends=True)
        found = []
        for line in lines:
            with suppress(ValueError):
                found += [json.loads(line)] if line.endswith(b"\n") else []
        return [news for news in found if isinstance(news, dict)]

    def _read_last_error_line(self) -> str:
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "the process printed no reason"

    def __enter__(self) -> LslMarks:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
