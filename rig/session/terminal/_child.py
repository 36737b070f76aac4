"""Start the console as a process on a terminal, read its messages in a thread, end it, and restore the terminal.

`rig.session.terminal.desk` uses it. During a hit nothing here may wait for the console, which may hang.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from queue import SimpleQueue
from typing import Any

from rig.core.child import with_this_package
from rig.core.errors import RigError
from rig.session.terminal import _terminal as terminal
from rig.session.terminal._messages import MessageReader, line_of

assert sys.platform != "win32"

MOST_PENDING = 1 << 20  # bytes that wait for a console; with more, the console does not read: it hangs
END_S = 2.0  # longest time for a console to restore the terminal and exit
READ_BYTES = 65536

Message = dict[str, Any]


class Child:
    """Console process (the operator's user interface in a terminal), seen from the session's process.

    `place` is the descriptor of the terminal, `before` its settings to restore later, `setup` the content of the first
    message to the console. Messages from the console are put into `inbox`, as pairs of this object and the message.

    Attributes
    ----------
    heard_s
        Time of the last message from the console (s, monotonic clock); before the first message, time of the start.
    greeted
        True if the console has sent a message.
    """

    def __init__(
        self, place: int, before: list[Any], setup: Message, inbox: SimpleQueue[tuple[Child, Message]]
    ) -> None:
        self._place, self._before = place, before
        self._inbox = inbox
        self._pending = bytearray()
        self._closed = False
        self.greeted = False
        try:
            with ExitStack() as ours:
                self._start(ours)
                ours.pop_all()
        # RuntimeError: the reader thread could not be started.
        except (OSError, RuntimeError) as error:
            raise RigError(
                f"the console cannot be started: {getattr(error, 'strerror', None) or error}",
                remedy="free memory, processes or open files, then resume the session",
            ) from error
        self.say("setup", **setup)

    def _start(self, ours: ExitStack) -> None:

        def owned(stack: ExitStack, *descriptors: int) -> None:
            for descriptor in descriptors:
                stack.callback(os.close, descriptor)

        with ExitStack() as theirs:
            self._complaints = _nameless()
            owned(ours, self._complaints)
            theirs_in, self._to = os.pipe()
            owned(theirs, theirs_in)
            owned(ours, self._to)
            self._from, theirs_out = os.pipe()
            owned(theirs, theirs_out)
            owned(ours, self._from)
            os.set_blocking(self._to, False)
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "rig.session.terminal", str(theirs_in), str(theirs_out)],
                stdin=self._place,
                stdout=self._place,
                stderr=self._complaints,
                pass_fds=(theirs_in, theirs_out),
                env=with_this_package(),
            )
        ours.callback(self._process.wait)
        ours.callback(self._process.kill)
        self.heard_s = time.monotonic()
        self._reader = threading.Thread(target=self._listen, name="rig-console", daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """Process ID of the operator's console."""
        return self._process.pid

    @property
    def dead(self) -> bool:
        """True if the process of the operator's console has ended."""
        return self._process.poll() is not None

    @property
    def silent_s(self) -> float:
        """Time since the last message from the operator's console (s)."""
        return time.monotonic() - self.heard_s

    def say(self, kind: str, **content: Any) -> None:
        """Send a message to the operator's console without waiting, even if the console does not read."""
        if not self._closed:
            self._pending += line_of(kind, **content)
            self.flush()

    def flush(self) -> None:
        """Send waiting bytes that the pipe to the console did not accept; kill the console if too many are waiting."""
        with suppress(BlockingIOError, BrokenPipeError):
            while self._pending and not self._closed:
                del self._pending[: os.write(self._to, self._pending)]
        if len(self._pending) > MOST_PENDING:
            self.kill()

    def complaint(self) -> str:
        """Return the last line that the console process wrote to standard error; "" if it wrote nothing."""
        length = os.fstat(self._complaints).st_size
        text = os.pread(self._complaints, 4096, max(0, length - 4096)).decode(errors="replace")
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return lines[-1] if lines else ""

    def kill(self) -> None:
        """Kill the console process at once, even if the process is stopped."""
        with suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGKILL)

    def close(self, *, last: bool = True) -> None:
        """End the console process, by force if needed; restore the terminal unless another console follows (`last`)."""
        if self._closed:
            return
        if not self.dead:
            self.say("end")
            # The reader sees the end of the pipe at once; `Popen.wait` would poll with growing intervals.
            self._reader.join(END_S)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(0.0 if self._reader.is_alive() else END_S)
        if not self.dead:
            self.kill()
            self._process.wait()
        if last:
            terminal.give_back(self._place, self._before)
        self._closed = True
        self._reader.join(END_S)
        os.close(self._to)
        os.close(self._complaints)

    def _listen(self) -> None:
        lines = MessageReader()
        try:
            while data := os.read(self._from, READ_BYTES):
                self.heard_s, self.greeted = time.monotonic(), True
                for message in lines.feed(data):
                    if message["kind"] != "alive":
                        self._inbox.put((self, message))
        finally:
            os.close(self._from)


def _nameless() -> int:
    with tempfile.TemporaryFile(buffering=0) as file:
        return os.dup(file.fileno())
