"""Print the state of the operator's user interface as plain lines, one line for each change.

The console (`_program`) uses it. It must not read a key or a clock.
"""

from rig.session.terminal import _words as words
from rig.session.terminal._conversation import Conversation
from rig.session.terminal._live import Snapshot


class PlainLines:
    """Printed texts of the operator's user interface, so that each text is printed only when it changes."""

    def __init__(self) -> None:
        self._printed: dict[str, str] = {}
        self._log: tuple[str, ...] = ()

    def lines(self, talk: Conversation, live: Snapshot | None, now_s: float) -> list[str]:
        """Return the texts of the user interface that have changed since the last call, one line each.

        `talk` is the state of the user interface, `live` contains the current values of a running trial, and `now_s` is
        the time on the caller's clock (s).
        """
        view = talk.view
        found = [self._new("keys", words.always(talk)), self._new("place", words.place(view))]
        found.append(self._new("state", f"state: {words.state(talk)}"))
        found.append(self._new("wall", self._wall(talk)))
        found.append(self._new("asked", f"asked: {view.asked}" if view.asked else ""))
        found.append(self._new("say", f"say: {view.say}" if view.say else ""))
        found.append(self._new("phase", "" if live is None else f"phase: {live.phase}"))
        found.append(self._new("last", f"last: {view.last}" if view.last else ""))
        fresh = view.lines[_common(self._log, view.lines) :]
        self._log = view.lines
        found += [f"log: {line}" for line in fresh if line != view.last]
        found.append(self._new("help", self._help(talk)))
        found.append(self._new(f"question {talk.asked}", self._question(talk)))
        found.append(self._new("notice", talk.notice))
        return [line for line in found if line]

    def _new(self, name: str, text: str) -> str:
        before, self._printed[name] = self._printed.get(name, ""), text
        return text if text != before else ""

    @staticmethod
    def _wall(talk: Conversation) -> str:
        view = talk.view
        if view.condition is None and view.stiffness is None:
            return ""
        return "wall: " + ", ".join(
            value for name, value in words.facts(view) if name in ("condition", "wall")
        )

    @staticmethod
    def _question(talk: Conversation) -> str:
        if talk.question is None and talk.twice is None:
            return ""
        if talk.entry is not None:
            purpose = talk.entry.purpose
            item = "" if purpose == "note" else words.question(talk, talk.due_s)
            return f"{item} {purpose}, then enter:".strip()
        began_s = talk.due_s - (talk.question.seconds if talk.question else 0.0)
        return f"{words.question(talk, began_s)} {words.choices(talk)}".strip()

    @staticmethod
    def _help(talk: Conversation) -> str:
        if not talk.help:
            return ""
        return "\n".join(f"{key}: {meaning}" for key, meaning in words.help_pairs(talk))


def _common(before: tuple[str, ...], now: tuple[str, ...]) -> int:
    """Return the number of first lines of `now` that are also the last lines of `before`."""
    for length in range(min(len(before), len(now)), 0, -1):
        if before[-length:] == now[:length]:
            return length
    return 0
