"""Ask over a line, whatever carries it: what a desk sends, and what is an answer.

The terminal (`desk`) and the page's job (`rig.extras.console.session_desk`) inherit from it.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, cast

from rig.core.errors import StoppedError
from rig.core.present import plain
from rig.session.engine._desk import Action, Desk, DeskView, Question, Reply
from rig.session.planning._keymap import VERDICTS

SILENCE_S = 2.0  # of who shows it while a hit runs; then the hit ends
POLL_S = 0.1
SHORTEST_S = 1e-3  # of a rest that is as good as over

Message = Mapping[str, Any]


class AskingDesk(Desk):
    """A desk at the other end of a line: subclasses send, receive, and check that the other end is alive."""

    def __init__(self) -> None:
        self._view: DeskView | None = None
        self._question: Question | None = None
        self._began_s = 0.0
        self._number = 0
        self._stop_asked = False

    @abstractmethod
    def _send(self, kind: str, **content: Any) -> None:
        """Send a message: ``view`` or ``ask``."""

    @abstractmethod
    def _take(self, patience_s: float) -> Message | None:
        """Return the next message, its ``kind`` in it, within so long (s); None for none."""

    @abstractmethod
    def _check_there(self) -> None:
        """Raise `StoppedError` when the other end must be feared to be gone while a hit runs."""

    def _is_renewed(self) -> bool:
        """Return True if the other end is a new one, which has received no question yet."""
        return False

    def show(self, view: DeskView) -> None:
        """Show how things stand; returns at once, also when who shows it hangs."""
        self._view = view
        self._send("view", view=plain(view))

    def ask(self, question: Question) -> Reply:
        """Ask, and wait for the answer.

        Raises
        ------
        StoppedError
            The console is gone, so that no answer can come.
        """
        if question.kind != "rest" or question != self._question:  # a rest continues while a note is written
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
        """Watch who shows it while a hit runs: STOP, and silence, end it."""
        return self._watch

    def _watch(self, ticks: int, phase: int) -> None:
        while self._next(0.0) is not None:
            pass
        if self._stop_asked:
            raise StoppedError("stopped at the console; the effort is zero")
        self._check_there()

    def _put(self, question: Question) -> None:
        """Send a question; for a rest, with its remaining time."""
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
        """Return the reply in a message; None when it is not one to this question."""
        # An answer names its question: one to an earlier question, or with an action that was not offered, is ignored.
        if message["kind"] != "reply" or message.get("number") != self._number:
            return None
        action, value = message.get("action"), str(message.get("value", ""))
        over = action == "go" and question.kind == "rest" and took_s > question.seconds - POLL_S
        if (action not in question.actions and not over) or (action == "judge" and value not in VERDICTS):
            return None
        shown_s = message.get("shown_s")  # since the question was on the screen, if the console reports it
        if shown_s is not None and question.kind != "rest":  # of which a note takes nothing
            took_s = min(took_s, max(0.0, float(shown_s)))
        return Reply(action=cast("Action", action), value=value, took_s=took_s)
