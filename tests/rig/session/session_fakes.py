"""Simulated rig and person for tests of sessions, without physics, so that a session takes milliseconds."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rig.analysis.identification._signs import check_signs
from rig.config import Experiment
from rig.config.presets import load as preset
from rig.core.check import Check, Outcome
from rig.core.errors import RigError
from rig.doctor.pace import Pace
from rig.experiments.motion.pulse import Pulse
from rig.recording.files import whole_file
from rig.session.engine._conduct import conduct
from rig.session.engine._desk import Desk, DeskView, Question, Reply
from rig.session.engine._directory import Session, begin
from rig.session.engine._log import Event
from rig.session.engine._rehearsal import Day, Person, RehearsalDesk
from rig.session.engine._runner import RefusedWalls, SessionWall, TrialDone
from rig.session.engine._state import BOOKKEEPING, SessionState
from rig.session.planning._load import protocol_from_mapping
from rig.session.planning._protocol import Protocol
from tests.conformance.studies import hit_outcome

TRUE_LIMIT = 430.0
TEXT = b"# as it was\n"  # of the protocol's file


def study(**keys: Any) -> dict[str, Any]:
    """Return a `study` section whose press the motor of koul-rigid can hold."""
    changes = {"operator.press": 2.0, "trial.minimum_rest_counts": 0.0}
    return {"title": "fakes", "preset": "koul-rigid", "seed": 5, "changes": changes, **keys}


SHORT_SEARCH: Mapping[str, Any] = {  # one trial
    "rule": "psi", "lowest": 100.0, "highest": 600.0, "step": 100.0, "settings": {"hits": 1},
}  # fmt: skip


def protocol_of(**sections: Any) -> Protocol:
    search = {"rule": "staircase", "lowest": 100.0, "highest": 600.0, "step": 25.0}
    table: dict[str, Any] = {
        "study": study(),
        "search": {**search, "settings": {"turns": 2, "most": 8}},
        "condition": [
            {"name": "dual-hidden", "scheme": "dual:20k/2k", "damping": [0.37]},
            {"name": "uniform-hidden", "scheme": "uniform:20k", "damping": [0.37]},
        ],
    }
    return protocol_from_mapping({**table, **sections}, "the test")


def started(directory: Path, protocol: Protocol | None = None) -> Session:
    """Begin a session about koul-rigid, on a simulated clock of its own."""
    return begin(
        directory, protocol or protocol_of(), preset("koul-rigid"), text=TEXT, sha256="0" * 64, code="P01", row=0,
        versions={"haptic-rig": "test"}, clock=Day(),
    )  # fmt: skip


def rehearsed(session: Session, runner: FakeRunner, person: Person) -> SessionState:
    assert isinstance(session.clock, Day)
    with session:
        return conduct(session, runner, RehearsalDesk(person, session.clock))


class FakeRunner:
    """A rig whose automatic verdict is that of a sharp stiffness limit, except in the trials of `fails`.

    `fails` maps a trial's number to changes of its log event, and to the error that ended it.
    """

    virtual = True
    simulated = True
    hand: Path | None = None
    arm_anyway = lossy_anyway = False
    messages: tuple[str, ...] = ()

    def __init__(self, fails: Mapping[int, tuple[Mapping[str, Any], RigError | None]] | None = None) -> None:
        self.fails = dict(fails or {})
        self.hits: list[tuple[int, float]] = []
        self.pulses: list[str] = []
        self.moves: list[bool] = []  # what the next pulses show; then all is well
        self.heat_of_a_hit = 0.01

    def facts(self, experiment: Experiment, changes: Mapping[str, Any]) -> dict[str, Any]:
        return {"url": "fake://", "device": experiment.rig.name, "firmware": "none", "simulated": True}

    def refusals(self, walls: Sequence[SessionWall]) -> Sequence[RefusedWalls]:
        return ()

    def pace(self, experiment: Experiment, changes: Mapping[str, Any]) -> Pace | None:
        return None

    def fits(self, experiment: Experiment, changes: Mapping[str, Any]) -> tuple[()]:
        return ()

    def pulse(self, experiment: Experiment, changes: Mapping[str, Any], directory: Path, name: str) -> Pulse:
        self.pulses.append(name)
        well = self.moves.pop(0) if self.moves else True
        found = Check("direction", Outcome.OK if well else Outcome.REFUSED, "as it is", "swap two wires")
        return Pulse(
            rig=experiment.rig.name,
            motion=experiment.rig.motion,
            device="fake",
            recording=directory / f"{name}.parquet",
            signs=check_signs(
                np.arange(9.0), np.zeros(9), np.zeros(9), resolution=1.0, expected_inertia=1.0, rest_s=1.0
            ),
            checks=(found,),
        )

    def hit(
        self,
        experiment: Experiment,
        changes: Mapping[str, Any],
        directory: Path,
        name: str,
        watch: Callable[[Experiment], Callable[[int, int], None] | None],
        heat: float,
        blinded: bool = False,
    ) -> TrialDone:
        number, stiffness = int(name[1:]), experiment.wall.stiffness
        self.hits.append((number, stiffness))
        seen = watch(experiment)
        if seen is not None:
            for phase in (1, 2, 3, 4):
                seen(phase, phase)
        path = directory / f"{name}.parquet"
        rows = np.random.default_rng(experiment.trial.seed).bytes(64)
        with whole_file(path) as file:
            file.write(rows)
        stable = stiffness < TRUE_LIMIT
        content = {
            "automatic": "stable" if stable else "limit cycle",
            "recording": f"trials/{path.name}",
            "sha256": hashlib.sha256(rows).hexdigest(),
            "rows_sha256": hashlib.sha256(rows).hexdigest(),
            "reasons": [] if stable else ["heard"],
            "numbers": {"heard": 0.1},
            "heat": heat + self.heat_of_a_hit,
        }
        changed, error = self.fails.get(number, ({}, None))
        return TrialDone(hit_outcome(**{**content, **changed}), error, 1.5)

    def close(self) -> None:
        pass


INVALID = {"automatic": "invalid", "reasons": ["the wall was never touched"]}
LOST = "from contact on, 2.1 % of the samples lost (limit 1 %), 7 in a row (limit 2): the link was late"
SPOILED = {**INVALID, "reasons": [LOST], "by_machine": True}


class ScriptedDesk(Desk):
    """A desk that answers by a function of the question, and records all views and questions."""

    def __init__(self, answer: Callable[[Question], Reply | None] = lambda question: None) -> None:
        self.answer = answer
        self.views: list[DeskView] = []
        self.questions: list[Question] = []

    def show(self, view: DeskView) -> None:
        self.views.append(view)

    def ask(self, question: Question) -> Reply:
        self.questions.append(question)
        reply = self.answer(question)
        if reply is not None:
            return reply
        if question.kind == "verdict":
            return Reply(action="judge", value="stable", took_s=1.0)
        if question.kind == "item":
            return Reply(action="answer", value="4", took_s=1.0)
        return Reply(action="go", took_s=question.seconds)


def decisions(events: list[Event]) -> list[tuple[str, dict[str, Any]]]:
    """Return kind and content of a log's events, without times and without bookkeeping of interruptions."""
    return [(event.kind, dict(event.content)) for event in events if event.kind not in BOOKKEEPING]
