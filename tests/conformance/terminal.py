"""A pseudo-terminal for tests of interactive programs: keys can be typed, and printed lines can be read."""

from __future__ import annotations

import codecs
import os
import select
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tests.conformance.started import LEASH, WAIT_S

LOOK_S = 0.05  # what is waited for may be about more than what is printed


# Runs a command as a shell would, in the foreground of its controlling terminal: ^C is the kernel's, and the terminal
# outlives the command.
_LAUNCH = """
import fcntl, os, signal, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
signal.signal(signal.SIGINT, lambda number, frame: None)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
pid = os.fork()
if pid == 0:
    os.execv(sys.argv[2], sys.argv[2:])
print(pid, file=sys.stderr, flush=True)
status = os.waitpid(pid, 0)[1]
os.read(int(sys.argv[1]), 1)
sys.exit(os.waitstatus_to_exitcode(status) & 255)
"""


@dataclass(frozen=True)
class Program:
    """A program in a terminal: its process number, and the shell that waits for it and then for the pipe's end."""

    shell: subprocess.Popen[str]
    pid: int
    leash: list[int]

    def wait(self, patience_s: float = WAIT_S) -> tuple[int, str]:
        """Wait for the program's end; return its exit code and its standard error."""
        if self.leash:
            os.close(self.leash.pop())
        _, err = self.shell.communicate(timeout=patience_s)
        return self.shell.returncode, err

    def end(self) -> None:
        """Kill the program if it still runs, and wait for it."""
        if self.shell.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            self.wait()


class Terminal:
    """A pseudo-terminal: `path` for the program, keys and lines for the test; a thread reads, so no output blocks."""

    def __init__(self) -> None:
        self.master, self.slave = os.openpty()
        self.path = os.ttyname(self.slave)
        self.printed = ""
        self.before = termios.tcgetattr(self.slave)
        self._changed = threading.Condition()
        self._closed = False
        self._typed = 0  # characters that had been printed when keys were typed last
        self._stop_reader, self._stop_writer = os.pipe()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        os.write(self._stop_writer, b".")
        self._thread.join(WAIT_S)
        for descriptor in (self.master, self.slave, self._stop_reader, self._stop_writer):
            os.close(descriptor)

    def run(self, *command: str, cwd: Path, env: Mapping[str, str] | None = None) -> Program:
        """Start a program in a new session with this as its controlling terminal; its errors go to a pipe."""
        reader, writer = os.pipe()
        process = subprocess.Popen(
            [*LEASH, sys.executable, "-c", _LAUNCH, str(reader), *command],
            pass_fds=(reader,),
            stdin=self.slave,
            stdout=self.slave,
            stderr=subprocess.PIPE,
            text=True,
            cwd=cwd,
            env={**os.environ, "TERM": "xterm-256color", **(env or {})},
            start_new_session=True,
        )
        assert process.stderr is not None
        os.close(reader)
        return Program(process, int(process.stderr.readline()), [writer])

    def type(self, keys: str) -> None:
        self._typed = len(self.printed)
        os.write(self.master, keys.encode())

    @property
    def fresh(self) -> str:
        """The text printed since the last keys."""
        return self.printed[self._typed :]

    @property
    def bells(self) -> int:
        return self.printed.count("\a")

    def wait(self, *texts: str, patience_s: float = WAIT_S) -> str:
        """Wait until all texts were printed since the last keys; return what was printed."""
        return self.until(lambda: all(text in self.fresh for text in texts), str(texts), patience_s)

    def until(self, condition: Callable[[], bool], what: str = "", patience_s: float = WAIT_S) -> str:
        """Wait until a condition is true; return what was printed since the last keys."""
        deadline = time.monotonic() + patience_s
        with self._changed:
            while not condition() and time.monotonic() < deadline:
                self._changed.wait(LOOK_S)
            if not condition():
                raise AssertionError(f"not there: {what}\n--- printed:\n{self.printed[-4000:]}")
            return self.fresh

    def attributes_are_back(self) -> bool:
        return termios.tcgetattr(self.slave) == self.before

    def _read(self) -> None:
        decoder = codecs.getincrementaldecoder("utf-8")("replace")
        while True:
            ready, _, _ = select.select([self.master, self._stop_reader], [], [])
            if self._stop_reader in ready:
                return
            try:
                data = os.read(self.master, 65536)
            except OSError:
                time.sleep(0.01)  # the other end is not open now
                continue
            with self._changed:
                self.printed += decoder.decode(data).replace("\r", "")
                self._changed.notify_all()
