"""Interface between a session and the operator at the rig: views, questions and replies.

Everything in a view or a question may be displayed: the engine omits what a blinded operator must not know. The engine
calls a desk; the terminal, the page and a simulated person implement it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

# Only for types: the console imports this module and must not load the session's engine.
if TYPE_CHECKING:
    from rig.session.engine._directory import Session

QuestionKind = Literal["ready", "verdict", "rest", "paused", "item", "trouble"]
# ready: before a trial, or before the motor moves the handle by itself. verdict: after a trial. rest: `seconds` are
# due, and "go" ends it early. paused: "go" continues.
# item: of the questionnaire. trouble: something went wrong (`text` says what): go tries again.

Action = Literal[
    "go",  # continue
    "judge",  # `value` is a verdict
    "answer",  # `value` answers a question of the questionnaire
    "redo",  # the last trial does not count and is repeated
    "pause",
    "note",  # `value` is the text; the same question is asked again
    "skip",  # end this search without a limit
    "abort",  # leave the session, which can be resumed later
]


@dataclass(frozen=True, slots=True, kw_only=True)
class DeskView:
    """Current state of a session, for display by the operator's user interface.

    Attributes
    ----------
    state
        Short name of the state: "ready", "homing", "free space", "go", "hold", "verdict?", "rest", "paused", "done" …
    say
        Text for the operator to read to the participant; empty if no text is due now.
    code, block, blocks, run, runs, trial, trials
        Code of the participant; number and total of blocks, searches (runs) and trials. `trials` is an estimate, 0 if
        unknown.
    practice, attempt
        True for a practice trial; number of the attempt at this trial, from 1.
    condition, stiffness, damping
        Condition and wall of the trial; None if the operator must not know them (blinded).
    blinded
        True if effort must be shown in words, because effort divided by penetration would reveal the stiffness.
    asked
        Required impact speed and press of the hand, in words; empty if the protocol requires none.
    scale
        Values for bars: start, wall, side, window (two ends), effort_limit, speed_limit, position_unit, effort_unit,
        velocity_unit.
    heat
        Heat of the motor's winding; 1 is the heat after hours at the nominal effort.
    last
        Result of the last trial in a few words, with the reason if the trial is invalid.
    lines
        Newest lines of the log, oldest first.
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
    """A question that the operator must answer before the session continues.

    Attributes
    ----------
    kind, text
        Kind, such as "verdict" or "rest", and text of the question.
    actions
        Actions that the reply may have.
    seconds
        Duration of the rest, for a question of kind "rest" (s).
    item
        Question of the questionnaire: name, text, kind, lowest, highest, choices.
    trial
        Number of the trial that the question concerns; 0 for no trial.
    """

    kind: QuestionKind
    text: str
    actions: tuple[Action, ...]
    seconds: float = 0.0
    item: Mapping[str, Any] | None = None
    trial: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """Reply of the operator to a question: action, its value (a verdict or a text), and the response time (s)."""

    action: Action
    value: str = ""
    took_s: float = 0.0


class Desk(ABC):
    """User interface of the operator at the rig, or a simulated person."""

    who: Literal["person", "simulated"] = "person"  # who judges here

    def attend(self, session: Session) -> None:  # noqa: B027  (who is asked and shown all needs no more)
        """Receive the session once, before any other call; it must not be changed."""

    @abstractmethod
    def show(self, view: DeskView) -> None:
        """Display the current state of the session; return at once."""

    @abstractmethod
    def ask(self, question: Question) -> Reply:
        """Ask the operator a question and wait for the reply; raise `StoppedError` if no reply is possible."""

    def watch(self) -> Callable[[int, int], None] | None:
        """Return a function to call a few times a second during a hit, with number of ticks and phase.

        The function may raise `rig.core.errors.StoppedError`; then the hit ends with zero effort. Return None if no
        function is needed.
        """
        return None

    def close(self) -> None:  # noqa: B027  (most leave nothing behind)
        """Restore the terminal or page to its state before the session."""

    def __enter__(self) -> Desk:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
