"""Rehearse a session with a simulated person: hits by the simulated hand, verdicts by known thresholds.

A rehearsal shows how long a protocol takes and how its search rules respond to lapses. Because the thresholds are
known, tests can check the results of an analysis. `rig session run --rehearse` and tests use it. It must never drive a
real rig.
"""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rig.config.checked import did_you_mean
from rig.control.verdict import Kind
from rig.core.errors import ConfigError
from rig.session.engine._clock import WallClock
from rig.session.engine._desk import Desk, DeskView, Question, Reply
from rig.session.engine._directory import Session
from rig.session.engine._state import SessionState
from rig.session.planning._names import normalise
from rig.session.planning._protocol import Protocol
from rig.session.planning._times import QUESTION_S
from rig.session.planning._trial import RecordedTrial
from rig.session.search._observer import Observer

_MAIN_VERDICT = {Kind.STABLE: "stable", Kind.LIMIT_CYCLE: "buzz", Kind.UNSTABLE: "unstable"}
LATENCY_S = (0.6, 1.6)  # shortest and longest response time of a simulated person


@dataclass(frozen=True, slots=True, kw_only=True)
class Person:
    """Simulated person with known thresholds of stiffness.

    Attributes
    ----------
    thresholds
        K50 of each condition: the stiffness at which half of the person's verdicts are "stable". For a condition
        without a threshold, the person repeats the automatic verdict, which is computed from the recording.
    spread
        Spread s of the psychometric function (unit of stiffness; `rig.session.search._psychometric`).
    lapse_rate
        Fraction of verdicts that are inverted by mistake (0 to 1).
    unsure
        Fraction of trials judged "unsure" (0 to 1).
    people_sd
        Standard deviation, over people, of the logarithm of the factor by which `of_code` multiplies the thresholds.
    """

    thresholds: Mapping[str, float]
    spread: float = 15.0
    lapse_rate: float = 0.0
    unsure: float = 0.0
    people_sd: float = 0.0

    def of_code(self, code: str, seed: int) -> Person:
        """Return the simulated person for a participant's code, who differs from other persons in the thresholds.

        All thresholds are multiplied by one random factor, which `code` and `seed` determine.
        """
        drawn = random.Random(f"person {seed} {code}").gauss(0.0, self.people_sd)
        return replace(self, thresholds={name: k * math.exp(drawn) for name, k in self.thresholds.items()})

    def judge(self, trial: RecordedTrial, drawn: np.random.Generator) -> str:
        """Return the simulated person's verdict on a trial: "stable", "buzz" (limit cycle), "unstable" or "unsure"."""
        if drawn.random() < self.unsure:
            return "unsure"
        automatic = _MAIN_VERDICT[Kind(trial.automatic)]
        threshold = self.thresholds.get(trial.condition)
        if threshold is None:
            if drawn.random() >= self.lapse_rate:
                return automatic
            return "buzz" if automatic == "stable" else "stable"
        observer = Observer(threshold=threshold, spread=self.spread, lapse_rate=self.lapse_rate)
        if observer.judge(trial.stiffness, drawn):
            return "stable"
        return "unstable" if automatic == "unstable" else "buzz"


def thresholds_of(given: Iterable[str]) -> dict[str, float]:
    """Return the stiffness threshold of each condition from texts like ``dual=430``.

    Raise `ConfigError` for a text of another form.
    """
    found: dict[str, float] = {}
    for text in given:
        name, equals, value = text.rpartition("=")
        name = normalise(name)
        try:
            found[name] = float(value)
        except ValueError:
            # As if nothing were given: one message for both wrong forms.
            equals = ""
        if not name or not equals:
            raise ConfigError(
                f"`threshold` {text} is not of the form CONDITION=STIFFNESS",
                remedy="write it like `threshold` dual=430",
            )
    return found


def check_person(person: Person, protocol: Protocol) -> None:
    """Raise `ConfigError` if a number of the simulated person is out of range, or a condition is unknown."""
    names = [one.name for one in protocol.condition]
    for name, stiffness in person.thresholds.items():
        if name not in names:
            listed = f"choose one of: {', '.join(map(repr, names))}"
            raise ConfigError(
                f"`threshold` {name}={stiffness:g}: the protocol has no condition {name!r}",
                remedy=did_you_mean(name, names, listed),
            )
    stiffnesses = {f"`threshold` {name}=": value for name, value in person.thresholds.items()}
    for option, value in {**stiffnesses, "`spread` ": person.spread}.items():
        if not 0.0 < value < math.inf:
            raise ConfigError(
                f"{option}{value:g} is not a stiffness: it must be finite and above 0",
                remedy="give a number above 0",
            )
    if not 0.0 <= person.people_sd < math.inf:
        raise ConfigError(
            f"`people_sd` {person.people_sd:g} is not a standard deviation",
            remedy="give 0 or a positive number, such as 0.2",
        )
    for option, share in (("`lapse_rate`", person.lapse_rate), ("unsure", person.unsure)):
        if not 0.0 <= share <= 1.0:
            raise ConfigError(
                f"{option} {share:g} is not a share of the simulated answers or trials",
                remedy="give a number from 0 to 1",
            )


class Day:
    """Virtual clock (s) of a session with a simulated person; only its methods advance it."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self) -> float:
        """Return the virtual time that has passed (s)."""
        return self.seconds

    def took(self, seconds: float) -> None:
        """Advance the virtual time by the duration of an action (s)."""
        self.seconds = round(self.seconds + seconds, 6)

    def resume_at(self, at: float) -> None:
        """Set the virtual time to `at` (s), the time of the newest event in the log."""
        self.seconds = at

    def rests(self, seconds: float) -> None:
        """Advance the virtual time by the duration of a rest (s)."""
        self.took(seconds)


class RealDay(WallClock):
    """Clock of a session with a simulated person that runs in real time."""

    def rests(self, seconds: float) -> None:
        """Wait for the duration of a rest (s)."""
        time.sleep(seconds)


class RehearsalDesk(Desk):
    """User interface with a simulated person, who replies at once; the clock advances by a response time."""

    who = "simulated"

    def __init__(
        self, person: Person, day: Day | RealDay, looks: Callable[[DeskView], None] | None = None
    ) -> None:
        self.person = person
        self.day = day
        self.looks = looks
        # State of the running session, which the engine updates.
        self.state: SessionState | None = None

    def attend(self, session: Session) -> None:
        """Store state and clock of a session; draw the simulated person's thresholds by the participant's code."""
        self.state = session.state
        self.person = self.person.of_code(session.state.code, session.state.seed)
        if isinstance(session.clock, Day | RealDay):
            self.day = session.clock

    def show(self, view: DeskView) -> None:
        """Pass the session's state to the function `looks`, which displays it, if there is one."""
        if self.looks is not None:
            self.looks(view)

    def ask(self, question: Question) -> Reply:
        """Return the reply of the simulated person, who skips a search with too many invalid trials."""
        reply = self._answer(question)
        (self.day.rests if question.kind == "rest" else self.day.took)(reply.took_s)
        return reply

    def _answer(self, question: Question) -> Reply:
        assert self.state is not None
        ready_s = self.state.protocol.trial.ready_s
        if question.kind == "verdict":
            trial = self.state.trial_numbered(question.trial)
            drawn = np.random.default_rng([trial.seed, 3])
            return Reply(
                action="judge",
                value=self.person.judge(trial, drawn),
                took_s=round(float(drawn.uniform(*LATENCY_S)), 3),
            )
        if question.kind == "item":
            return Reply(action="answer", value=_plain_answer(question.item or {}), took_s=QUESTION_S)
        if question.kind == "rest":
            return Reply(action="go", took_s=question.seconds)
        if question.kind == "trouble":
            return Reply(action="skip" if "skip" in question.actions else "go", took_s=ready_s)
        return Reply(action="go", took_s=ready_s)


def _plain_answer(item: Mapping[str, Any]) -> str:
    """Return the simulated person's answer to a question: the first choice, the middle of a scale, or "rehearsal"."""
    if item.get("kind") == "choice":
        return str(item["choices"][0])
    if item.get("kind") == "scale":
        return str((item["lowest"] + item["highest"]) // 2)
    return "rehearsal"
