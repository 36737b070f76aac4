"""State of the operator's user interface: displayed view, open question, and the effect of each key.

The terminal and the page in the browser share this state. It uses no terminal, pipe or clock. The operator may request
a pause, a note or the end of the session at any time; the request takes effect at the next question.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast

from rig.session.engine._desk import Action, DeskView, Question
from rig.session.planning._items import describe_answer, parse_answer
from rig.session.planning._keymap import HELP, STOP, VERDICTS, KeyMap
from rig.session.terminal._held import RELEASED_S, HeldKeys
from rig.session.terminal._pointer import HandKind

LATER: tuple[Action, ...] = ("pause", "note", "abort")  # may be requested while no question is open
TWICE: dict[Action, str] = {  # actions to confirm with a second key, since a wrong key must not cause them
    "abort": "leave the session (it can be resumed)",
    "skip": "end this run (search) without a limit",
}
BACK = (HELP, "enter", "escape")  # keys that only close the list of keys
MOST_TEXT = 500


@dataclass(frozen=True, slots=True)
class Answer:
    """Reply of the operator to the session: an action with its value (a verdict, an answer or a text)."""

    action: Action
    value: str = ""


@dataclass(frozen=True, slots=True)
class StopPressed:
    """Request of the operator for zero effort at once."""


Decision = Answer | StopPressed


@dataclass(slots=True)
class TextEntry:
    """Text that the operator is typing: a note, or the answer to a question of the questionnaire."""

    purpose: Literal["note", "item"]
    text: str = ""


class Conversation:
    """State of the operator's user interface.

    Attributes
    ----------
    view
        View of the session that is displayed.
    question
        Open question; None while the session is busy.
    asked
        Number of questions so far; a repeated question counts again.
    due_s
        Time at which a rest is over (s, on the caller's clock).
    entry
        Text that the operator is typing, or None.
    twice
        Action that the operator must confirm with the next key, or None.
    later
        Action that the operator requested for the next question, or None.
    live
        True while a control loop runs; the caller sets it.
    notice
        Message about the last key if the key did not have its usual effect.
    help
        True while the list of keys is displayed.
    hand
        Input device that moves the simulated hand ("mouse", "keyboard"), or None.
    held
        Keys that were already held down before the question.
    """

    def __init__(self, keymap: KeyMap, hand: HandKind | None = None) -> None:
        self.keymap, self.hand = keymap, hand
        self.held = HeldKeys()
        self.view = DeskView(state="starting")
        self.question: Question | None = None
        self.asked = 0
        self.due_s = 0.0
        self.entry: TextEntry | None = None
        self.twice: Action | None = None
        self.later: Action | None = None
        self.live = False
        self.notice = ""
        self.help = False

    def see(self, view: Mapping[str, Any]) -> None:
        """Replace the displayed state of the session by the content of a message from the session."""
        self.view = DeskView(**{**view, "lines": tuple(view.get("lines", ()))})

    def ask(self, question: Mapping[str, Any], now_s: float) -> list[Decision]:
        """Open a new question at `now_s` (s); return an action that the operator requested earlier as the reply."""
        asked = Question(**{**question, "actions": tuple(question["actions"])})
        self.question, self.due_s = asked, now_s + asked.seconds
        self.held.ask(now_s)
        self.asked += 1
        self.entry, self.twice, self.notice = None, None, ""
        # Each end of a hit asks a question, which the list of keys must not cover.
        self.help = False
        later, self.later = self.later, None
        if later is not None and later in asked.actions:
            return self._act(later, sure=True)
        if asked.kind == "item":
            self.entry = TextEntry("item")
        return []

    def pass_time(self, now_s: float) -> list[Decision]:
        """Return the reply that ends a rest that is over at `now_s` (s), unless the operator is typing."""
        if self.left_s(now_s) > 0.0 or self.entry or self.twice or not self._resting:
            return []
        return self._answer(Answer("go"))

    def left_s(self, now_s: float) -> float:
        """Return the remaining time of the current rest (s); 0 outside a rest."""
        return max(0.0, self.due_s - now_s) if self._resting else 0.0

    @property
    def _resting(self) -> bool:
        return self.question is not None and self.question.kind == "rest" and self.question.seconds > 0.0

    @property
    def moving(self) -> bool:
        """True if the handle may move: a control loop runs, or no question is open."""
        return self.live or self.question is None

    @property
    def allowed(self) -> tuple[Action, ...]:
        """Actions with which the operator may answer the open question; empty without a question."""
        return () if self.question is None else self.question.actions

    def press(self, key: str, now_s: float | None = None) -> list[Decision]:
        """Process a pressed key and return the resulting decisions (replies, or STOP).

        `now_s` is the time at which the key arrived (s, on the caller's clock); None for input that cannot be a held
        key.
        """
        self.notice = ""
        # A key answers only the question that is open when it is pressed: what is typed during a hit is no verdict
        # about it.
        is_new = now_s is None or self.held.arrive(key, now_s)
        # STOP in every mode, except in a line that is being typed while nothing moves.
        if key == STOP and (self.moving or self.entry is None):
            self.notice = "STOP" if self.moving else "STOP: nothing is moving"
            self.help = False
            return [StopPressed()]
        if self.help:
            self.help = False  # a key acts as the page says, except for those that only close it (`BACK`)
            if key in BACK:
                return []
        is_text = self.entry is not None and (key != "enter" or self.entry.text)
        if not (is_new or is_text or self.question is None):
            self.notice = (
                f"{key} was held down before the question; release it for {RELEASED_S:g} s, then press it"
            )
            return []
        if self.twice is not None:
            return self._confirm(key)
        if self.entry is not None:
            return self._type(key, self.entry)
        return self._mean(self.keymap.meaning(key), key)

    def line(self, text: str) -> list[Decision]:
        """Process a complete typed line as the text of a note or an answer; return the replies to the session.

        Return [] if no text is expected.
        """
        if self.entry is None:
            return []
        self.entry.text = "".join(one for one in text if one.isprintable())[:MOST_TEXT]
        return self._finish_entry(self.entry)

    def _mean(self, meaning: str, key: str) -> list[Decision]:
        if meaning == "help":
            self.help = True
            return []
        if not meaning:
            self.notice = f"{key} has no function (? lists the keys)"
            return []
        action: Action = "judge" if meaning in VERDICTS else cast("Action", meaning)
        if action in self.allowed:
            return self._answer(Answer("judge", meaning)) if action == "judge" else self._act(action)
        if self.question is not None and self.question.kind == "item" and action == "go":
            self.entry = TextEntry("item")
            return []
        if action in LATER and self.question is None:
            return self._act(action) if action in TWICE else self._remember(action)
        self.notice = f"{meaning} is not possible now"
        return []

    def _act(self, action: Action, *, sure: bool = False) -> list[Decision]:
        if action == "note":
            self.entry = TextEntry("note")
            return []
        if action in TWICE and not sure:
            self.twice = action
            # The same key pressed once more confirms the action, but not the key while it is held down.
            self.held.ask_again()
            return []
        return self._answer(Answer(action))

    def _remember(self, action: Action) -> list[Decision]:
        self.later = action
        self.notice = f"{action}: will follow when this is over"
        return []

    def _confirm(self, key: str) -> list[Decision]:
        action, self.twice = self.twice, None
        assert action is not None
        if key.lower() != "y" and self.keymap.meaning(key) != action:
            self.notice = f"{action}: cancelled"
            return []
        if action in self.allowed:
            return self._answer(Answer(action))
        self._remember(action)
        return [StopPressed()] if self.moving else []

    def _answer(self, answer: Answer) -> list[Decision]:
        self.question, self.entry, self.twice = None, None, None
        return [answer]

    def _type(self, key: str, entry: TextEntry) -> list[Decision]:
        if key == "enter":
            return self._finish_entry(entry)
        if key == "escape":
            self.entry = None
        elif key == "backspace":
            entry.text = entry.text[:-1]
        elif key == "ctrl+u":
            entry.text = ""
        elif key == STOP or len(key) == 1:
            entry.text = (entry.text + (" " if key == STOP else key))[:MOST_TEXT]
        return []

    def _finish_entry(self, entry: TextEntry) -> list[Decision]:
        text = entry.text.strip()
        if entry.purpose == "note":
            if text:
                return self._answer(Answer("note", text))
            # The log stores no empty notes.
            self.entry = None
            return []
        value = self._answer_of(text)
        if value is None:
            entry.text = ""
            return []
        return self._answer(Answer("answer", value))

    def _answer_of(self, text: str) -> str | None:
        item = (self.question.item if self.question is not None else None) or {"kind": "text"}
        value = parse_answer(item, text)
        if value is None:
            self.notice = f"please give {describe_answer(item)}"
        return None if value is None else str(value)
