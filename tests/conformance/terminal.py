"""A terminal that a test holds: a pseudo-terminal whose screen can be read, also of programs that draw on it.

Only what such a program needs is understood (ECMA-48): cursor moves, erasing, SGR (ignored), private modes (kept in
`Screen.modes`), the bell. Each character takes one cell.
"""

from __future__ import annotations

import codecs
import fcntl
import os
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tests.conformance.started import LEASH

PATIENCE_S = 30.0
LOOK_S = 0.05  # what is waited for may be about more than the screen
ROWS, COLUMNS = 24, 80

_SEQUENCE = re.compile(
    r"\x1b\[([<=>?]?)([0-9;]*)([ -/]*)([@-~])|\x1b\][^\x07\x1b]*(?:\x07|\x1b\\)|\x1b[()].|\x1b[@-Z\\-~]"
)


class Screen:
    """What stands on the screen after some output."""

    def __init__(self, rows: int = ROWS, columns: int = COLUMNS) -> None:
        self.modes: set[int] = set()
        self.asked: list[int] = []  # modes that the program asked about
        self.bells = 0
        self.entered = 0  # how often a program took a screen of its own
        self.printed = ""  # all characters, in the order in which they came
        self._rest = ""
        self._saved: list[list[str]] | None = None
        self.resize(rows, columns)

    def resize(self, rows: int, columns: int) -> None:
        """Another size, and nothing on it."""
        self.rows, self.columns = rows, columns
        self.cells = [[" "] * columns for _ in range(rows)]
        self.row = self.column = 0

    @property
    def text(self) -> str:
        """All lines."""
        return "\n".join("".join(row).rstrip() for row in self.cells)

    def feed(self, text: str) -> None:
        """Take output."""
        text = self._rest + text
        self._rest = ""
        at = 0
        while at < len(text):
            if text[at] == "\x1b":
                found = _SEQUENCE.match(text, at)
                if found is None:
                    if len(text) - at < 64:
                        self._rest = text[at:]  # not complete
                        return
                    at += 1
                    continue
                if found[4]:
                    self._control(found[1], found[2], found[3], found[4])
                at = found.end()
            else:
                self._put(text[at])
                at += 1

    def _put(self, character: str) -> None:
        if character == "\r":
            self.column = 0
        elif character == "\n":
            self.printed += "\n"
            self._down()
        elif character == "\b":
            self.column = max(0, self.column - 1)
        elif character == "\a":
            self.bells += 1
        elif character >= " ":
            self.printed += character
            if self.column >= self.columns:
                self.column = 0
                self._down()
            self.cells[self.row][self.column] = character
            self.column += 1

    def _down(self) -> None:
        if self.row + 1 < self.rows:
            self.row += 1
        else:
            self.cells = [*self.cells[1:], [" "] * self.columns]

    def _control(self, private: str, numbers: str, between: str, final: str) -> None:
        values = [int(part) if part else 0 for part in numbers.split(";")]
        if private == "?" and between == "$" and final == "p":
            self.asked += values
        elif private == "?" and final in "hl":
            (self.modes.update if final == "h" else self.modes.difference_update)(values)
            if 1049 in values:
                self._alternate(final == "h")
        elif private or between:
            return
        elif final in "Hf":
            row, column = (*values, 0)[:2] if len(values) > 1 else (values[0], 1)
            self.row = min(self.rows, max(1, row)) - 1
            self.column = min(self.columns, max(1, column)) - 1
        elif final in "ABCD":
            count = max(1, values[0])
            self.row = min(self.rows - 1, max(0, self.row + {"A": -count, "B": count}.get(final, 0)))
            self.column = min(self.columns - 1, max(0, self.column + {"D": -count, "C": count}.get(final, 0)))
        elif final == "G":
            self.column = min(self.columns, max(1, values[0])) - 1
        elif final in "JK":
            self._erase(final, values[0])

    def _alternate(self, on: bool) -> None:
        if on:
            self.entered += 1
            self._saved = self._saved or self.cells
            self.cells = [[" "] * self.columns for _ in range(self.rows)]
        elif not on and self._saved is not None:
            self.cells, self._saved = self._saved, None

    def _erase(self, final: str, what: int) -> None:
        cursor = self.row * self.columns + self.column
        line = self.row * self.columns
        first, last = (0, self.rows * self.columns) if final == "J" else (line, line + self.columns)
        first, last = (
            (max(first, cursor), last)
            if what == 0
            else (first, min(last, cursor + 1))
            if what == 1
            else (first, last)
        )
        for place in range(first, last):
            self.cells[place // self.columns][place % self.columns] = " "


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
    """A program in a terminal: its pid, and the shell that waits for it, and then for the end of a pipe."""

    shell: subprocess.Popen[str]
    pid: int
    leash: list[int]

    def wait(self, patience_s: float = PATIENCE_S) -> tuple[int, str]:
        """Wait for its end; exit code and what it wrote to standard error."""
        if self.leash:
            os.close(self.leash.pop())
        _, err = self.shell.communicate(timeout=patience_s)
        return self.shell.returncode, err

    def end(self) -> None:
        """Leave nothing of it."""
        if self.shell.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            self.wait()


class Terminal:
    """A pseudo-terminal: `path` for the program, keys and screen for the test. A thread reads: no output blocks."""

    def __init__(self, rows: int = ROWS, columns: int = COLUMNS) -> None:
        self.master, self.slave = os.openpty()
        self.path = os.ttyname(self.slave)
        self.screen = Screen(rows, columns)
        self.before = termios.tcgetattr(self.slave)
        self._changed = threading.Condition()
        self._closed = False
        self._typed = 0  # characters that had been printed when keys were typed last
        self._stop_reader, self._stop_writer = os.pipe()
        self._size(rows, columns)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave nothing open."""
        if self._closed:
            return
        self._closed = True
        os.write(self._stop_writer, b".")
        self._thread.join(PATIENCE_S)
        for descriptor in (self.master, self.slave, self._stop_reader, self._stop_writer):
            os.close(descriptor)

    def run(self, *command: str, cwd: Path, env: Mapping[str, str] | None = None) -> Program:
        """Start a program in a session of its own whose controlling terminal this is; its errors go to a pipe."""
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
        """Press keys."""
        self._typed = len(self.screen.printed)
        os.write(self.master, keys.encode())

    @property
    def fresh(self) -> str:
        """All lines that were printed since keys were typed last."""
        return self.screen.printed[self._typed :]

    def wait_fresh(self, *texts: str, patience_s: float = PATIENCE_S) -> str:
        """Wait until all texts were printed since keys were typed last; returns these lines."""
        self.until(lambda: all(text in self.fresh for text in texts), str(texts), patience_s)
        return self.fresh

    def resize(self, rows: int, columns: int) -> None:
        """Another window; who wants to know of it is told by the kernel only where this is its controlling terminal."""
        with self._changed:
            self.screen.resize(rows, columns)
        self._size(rows, columns)

    def wait(self, *texts: str, patience_s: float = PATIENCE_S) -> str:
        """Wait until all texts stand on the screen; returns it."""
        return self.until(lambda: all(text in self.screen.text for text in texts), str(texts), patience_s)

    def wait_printed(self, *texts: str, patience_s: float = PATIENCE_S) -> str:
        """Wait until all texts were printed, in a program that prints lines; returns all that was."""
        self.until(lambda: all(text in self.screen.printed for text in texts), str(texts), patience_s)
        return self.screen.printed

    def until(self, condition: Callable[[], bool], what: str = "", patience_s: float = PATIENCE_S) -> str:
        """Wait for something about the screen."""
        deadline = time.monotonic() + patience_s
        with self._changed:
            while not condition() and time.monotonic() < deadline:
                self._changed.wait(LOOK_S)
            if not condition():
                raise AssertionError(
                    f"not there: {what}\n{self.screen.text}\n--- printed:\n{self.screen.printed[-2000:]}"
                )
            return self.screen.text

    def attributes_are_back(self) -> bool:
        """Whether the terminal is set as it was."""
        return termios.tcgetattr(self.slave) == self.before

    def _size(self, rows: int, columns: int) -> None:
        fcntl.ioctl(
            self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, columns * 8, rows * 16)
        )

    def _read(self) -> None:
        decoder = codecs.getincrementaldecoder("utf-8")("replace")
        while True:
            ready, _, _ = select.select([self.master, self._stop_reader], [], [])
            if self._stop_reader in ready:
                return
            try:
                data = os.read(self.master, 65536)
            except OSError:
                time.sleep(0.01)  # nobody has the other end open now
                continue
            with self._changed:
                self.screen.feed(decoder.decode(data))
                self._changed.notify_all()
