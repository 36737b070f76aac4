"""Messages between a job and its console, on the side of the job; `rig.extras.console.worker` lists them.

Jobs use it. Standard output carries the messages; the console ignores other lines there.
"""

import json
import os
import sys
import threading
import time
from queue import Empty, SimpleQueue
from typing import Any

from rig.core.errors import StoppedError
from rig.core.present import plain

SILENT_S = 2.0  # after which a console is taken to hang: it beats twenty times a second


class Talk:
    """Connection of a background job (run, session or map) to the console, through standard input and output.

    If `is_detached`, the job continues without its console.
    """

    def __init__(self, is_detached: bool) -> None:
        self._is_detached = is_detached
        self._lock = threading.Lock()
        self._answers: SimpleQueue[Any] = SimpleQueue()
        self._gone = threading.Event()
        self._last_line_s = time.monotonic()

    def tell(self, say: str, /, **content: Any) -> None:
        """Send a message with the name `say`; without effect if the console has ended."""
        line = json.dumps({"say": say, **plain(content)}).encode() + b"\n"
        try:
            with self._lock:
                os.write(1, line)
        except OSError:
            # The pipe is closed. The job learns it at its next report, where it can stop in order.
            self._gone.set()

    def progress(self, **content: Any) -> None:
        """Send the progress of the job to the console.

        Raises `StoppedError` if the console has ended or is silent for `SILENT_S` (s), unless the job is detached.
        """
        if time.monotonic() - self._last_line_s > SILENT_S:
            # The console hangs, so that a STOP could not arrive.
            self._gone.set()
        if self._gone.is_set() and not self._is_detached:
            raise StoppedError("the connection to the console was lost", remedy="start it again: rig console")
        self.tell("progress", **content)

    def ask(self, **content: Any) -> Any:
        """Send a question to the operator, wait, and return the answer; raise `StoppedError` if the console ended."""
        self.tell("asks", **content)
        answer = None if self._gone.is_set() else self._answers.get()
        if answer is None:
            raise StoppedError(
                "the console ended before it answered a request", remedy="start it again: rig console"
            )
        return answer

    def hear(self, patience_s: float) -> Any:
        """Return the console's next message, or None after `patience_s`; raise `StoppedError` if the console ended."""
        try:
            message = self._answers.get(timeout=patience_s) if patience_s else self._answers.get_nowait()
        except Empty:
            return None
        if message is None:
            self._answers.put(None)
            raise StoppedError("the connection to the console was lost", remedy="start it again: rig console")
        return message

    @property
    def silent_s(self) -> float:
        """Return the time since the last line from the console (s)."""
        return time.monotonic() - self._last_line_s

    def listen(self) -> None:
        """Read lines from the console until it ends; runs in a thread. An empty line is the console's heartbeat."""
        for line in sys.stdin:
            self._last_line_s = time.monotonic()
            if line.strip():
                self._answers.put(json.loads(line))
        self._gone.set()
        self._answers.put(None)
