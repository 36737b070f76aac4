"""The person at the rig: what a session shows and asks there, and the replies.

All that a view or a question contains may be shown: the engine leaves out what a blinded operator must not know, so
nothing behind this interface has to keep a secret.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:  # the console knows desks, and need not know of sessions
    from rig.session.engine._directory import Session

QuestionKind = Literal["ready", "verdict", "rest", "paused", "item", "trouble"]
# ready: before a trial, or before the motor moves the handle by itself. verdict: after a trial. rest: `seconds` are
# due, and "go" ends it early. paused: "go" continues.
# item: of the questionnaire. trouble: something went wrong (`text` says what): go tries again.

Action = Literal[
    "go",  # on with it
    "judge",  # `value` is a verdict
    "answer",  # `value` answers an item
    "redo",  # the last trial does not count and comes again
    "pause",
    "note",  # `value` is the text; the same question is asked again
    "skip",  # leave this run
    "abort",  # leave the session, to be resumed some day
]


@dataclass(frozen=True, slots=True, kw_only=True)
class DeskView:
    """What a desk shows now.

    Attributes
    ----------
    state
        In a word or two: "ready", "homing", "free space", "go", "hold", "verdict?", "rest", "paused", "done" …
    say
        What to say to the participant now; empty for nothing.
    code, block, blocks, run, runs, trial, trials
        Where the session stands; `trials` is about how many there will be, 0 if unknown.
    practice, attempt
        Whether it counts; which attempt at a trial it is, from 1.
    condition, stiffness, damping
        None where the operator is blinded.
    blinded
        Whether effort may be shown in words only (`rig.session.terminal`): effort over penetration is stiffness.
    asked
        Of the hand: impact speed and press, in words; empty for nothing.
    scale
        For bars: start, wall, side, window (two ends), effort_limit, speed_limit, position_unit, effort_unit,
        velocity_unit.
    heat
        Share of the winding's budget.
    last
        What the last trial came to, in a few words, and why it is invalid.
    lines
        The newest lines of the log, oldest first.
    """

    state: str
    say: str = ""
    code: str = ""
    block: int = 0
    blocks: int = 0
    run: int = 0
    runs: int = 0
    trial: int = 0
    trials: int = 0
    practice: bool = False
    attempt: int = 1
    condition: str | None = None
    stiffness: float | None = None
    damping: float | None = None
    blinded: bool = True
    asked: str = ""
    scale: Mapping[str, Any] = field(default_factory=dict)
    heat: float = 0.0
    last: str = ""
    lines: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """A question that must be answered before the session continues.

    Attributes
    ----------
    actions
        Permitted answers.
    seconds
        Of a rest that is due.
    item
        Of the questionnaire: name, text, kind, lowest, highest, choices.
    trial
        That the question is about; 0 for none.
    """

    kind: QuestionKind
    text: str
    actions: tuple[Action, ...]
    seconds: float = 0.0
    item: Mapping[str, Any] | None = None
    trial: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """An answer, and how long it took (s)."""

    action: Action
    value: str = ""
    took_s: float = 0.0


class Desk(ABC):
    """A person at the rig, or what stands in for one."""

    who: Literal["person", "simulated"] = "person"  # who judges here

    def attend(self, session: Session) -> None:  # noqa: B027  (who is asked and shown all needs no more)
        """Called once, before anything else, with the session. It changes by itself: change nothing of it here."""

    @abstractmethod
    def show(self, view: DeskView) -> None:
        """Show how things stand; returns at once."""

    @abstractmethod
    def ask(self, question: Question) -> Reply:
        """Ask, and wait for the answer.

        Raises `rig.core.errors.StoppedError` when no answer can come any more.
        """

    def watch(self) -> Callable[[int, int], None] | None:
        """Return a function to call a few times a second during a hit, with ticks and phase; None if not needed.

        It may raise `rig.core.errors.StoppedError`: the hit ends with zero effort.
        """
        return None

    def close(self) -> None:  # noqa: B027  (most leave nothing behind)
        """Leave the place as it was found."""

    def __enter__(self) -> Desk:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
