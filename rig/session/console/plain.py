"""The console as lines: one for each thing that changes. For screen readers, dumb terminals and scripts."""

from __future__ import annotations

from rig.session.console import words
from rig.session.console.conversation import Conversation
from rig.session.console.live import Snapshot


class PlainLines:
    """What was said already, so that each thing is said once."""

    def __init__(self) -> None:
        self._said: dict[str, str] = {}
        self._log: tuple[str, ...] = ()

    def lines(self, told: Conversation, live: Snapshot | None, now_s: float) -> list[str]:
        """What is new, a line each."""
        view = told.view
        found = [self._new("place", words.place(view)), self._new("state", f"state: {words.state(told)}")]
        found.append(self._new("wall", self._wall(told)))
        found.append(self._new("say", f"say: {view.say}" if view.say else ""))
        found.append(self._new("phase", "" if live is None else f"phase: {live.phase}"))
        found.append(self._new("last", f"last: {view.last}" if view.last else ""))
        fresh = view.lines[_common(self._log, view.lines) :]
        self._log = view.lines
        found += [f"log: {line}" for line in fresh]
        found.append(self._new("help", self._help(told)))
        found.append(self._new(f"question {told.asked}", self._question(told)))
        found.append(self._new("notice", told.notice))
        return [line for line in found if line]

    def _new(self, name: str, text: str) -> str:
        """The text if it is another one than was said."""
        before, self._said[name] = self._said.get(name, ""), text
        return text if text != before else ""

    @staticmethod
    def _wall(told: Conversation) -> str:
        view = told.view
        if view.condition is None and view.stiffness is None:
            return ""
        return "wall: " + ", ".join(
            value for name, value in words.facts(view) if name in ("condition", "wall")
        )

    @staticmethod
    def _question(told: Conversation) -> str:
        if told.question is None and told.twice is None:
            return ""
        if told.entry is not None:
            purpose = told.entry.purpose
            item = "" if purpose == "note" else words.question(told, told.due_s)
            return f"{item} {purpose}, then enter:".strip()
        began_s = told.due_s - (told.question.seconds if told.question else 0.0)
        return f"{words.question(told, began_s)} {words.choices(told)}".strip()

    @staticmethod
    def _help(told: Conversation) -> str:
        if not told.help:
            return ""
        return "\n".join(f"{key}: {meaning}" for key, meaning in words.help_pairs(told.keymap))


def _common(before: tuple[str, ...], now: tuple[str, ...]) -> int:
    """How many of the lines now were there before: the longest end of before that now begins with."""
    for length in range(min(len(before), len(now)), 0, -1):
        if before[-length:] == now[:length]:
            return length
    return 0
