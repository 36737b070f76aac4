"""Send views and questions to a user interface in another process, and receive the replies.

The desks (the session's side of the operator's user interface) of the terminal (`desk`) and of the page in the browser
(`rig.extras.console.session_desk`) inherit from `AskingDesk`.
"""

import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, cast

from rig.core.errors import StoppedError
from rig.core.present import plain
from rig.session.engine._desk import Action, Desk, DeskView, Question, Reply
from rig.session.planning._keymap import VERDICTS

SILENCE_S = 2.0  # longest silence of the user interface while a hit runs; after it the hit ends
POLL_S = 0.1
SHORTEST_S = 1e-3  # of a rest: 0 would mean a rest without an end

Message = Mapping[str, Any]


class AskingDesk(Desk):
    """The session's side of an operator's user interface that runs in another process.

    Subclasses send and receive the messages, and check that the other process is alive.
    """

    def __init__(self) -> None:
        self._view: DeskView | None = None
        self._question: Question | None = None
        self._began_s = 0.0
        self._number = 0
        self._stop_asked = False

    @abstractmethod
    def _send(self, kind: str, **content: Any) -> None:
        """Send a message of the kind ``view`` or ``ask`` to the user interface."""

    @abstractmethod
    def _take(self, patience_s: float) -> Message | None:
        """Return the next message from the user interface; None if none arrives within `patience_s` (s)."""

    @abstractmethod
    def _check_there(self) -> None:
        """Raise `StoppedError` if the user interface does not respond while a hit runs."""

    def _is_renewed(self) -> bool:
        """Return True if the user interface was restarted, so that the question must be sent again."""
        return False

    def show(self, view: DeskView) -> None:
        """Display the current state of the session; return at once, even if the user interface hangs."""
        self._view = view
        self._send("view", view=plain(view))

    def ask(self, question: Question) -> Reply:
        """Ask the operator a question and wait for the reply; raise `StoppedError` if the user interface ended."""
        # After a note the same rest continues, so its time is not started again.
        if question.kind != "rest" or question != self._question:
            self._began_s = time.monotonic()
        self._question = question
        self._number += 1
        self._put(question)
        while True:
            message = self._next(POLL_S)
            took_s = time.monotonic() - self._began_s
            reply = None if message is None else self._reply(message, question, took_s)
            if reply is not None:
                # A STOP without a hit ends the hit that was running, not the next one.
                self._stop_asked = False
                if reply.action != "note":
                    self._question = None
                return reply
            if self._is_renewed():
                self._put(question)

    def watch(self) -> Callable[[int, int], None] | None:
        """Return a function to call regularly during a hit, with the number of ticks and the phase.

        The function raises `StoppedError`, which ends the hit, if the operator requests a stop or the user interface
        hangs.
        """
        return self._watch

    def _watch(self, ticks: int, phase: int) -> None:
        while self._next(0.0) is not None:
            pass
        if self._stop_asked:
            raise StoppedError("stopped at the console by the operator; the effort is zero")
        self._check_there()

    def _put(self, question: Question) -> None:
        seconds = question.seconds
        if seconds:
            seconds = max(SHORTEST_S, seconds - (time.monotonic() - self._began_s))
        self._send("ask", number=self._number, question=plain(replace(question, seconds=seconds)))

    def _next(self, patience_s: float) -> Message | None:
        message = self._take(patience_s)
        if message is not None and message["kind"] == "stop":
            self._stop_asked = True
        return message

    def _reply(self, message: Message, question: Question, took_s: float) -> Reply | None:
        """Return the reply in a message; None if the message does not answer this question, asked `took_s` (s) ago."""
        # An answer names its question: one to an earlier question, or with an action that was not offered, is ignored.
        if message["kind"] != "reply" or message.get("number") != self._number:
            return None
        action, value = message.get("action"), str(message.get("value", ""))
        over = action == "go" and question.kind == "rest" and took_s > question.seconds - POLL_S
        if (action not in question.actions and not over) or (action == "judge" and value not in VERDICTS):
            return None
        # Time (s) since the question was on the screen, if the user interface reports it.
        shown_s = message.get("shown_s")
        if shown_s is not None and question.kind != "rest":
            took_s = min(took_s, max(0.0, float(shown_s)))
        return Reply(action=cast("Action", action), value=value, took_s=took_s)
