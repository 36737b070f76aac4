"""Redo: a trial that does not count is repeated, also if a stop rule is about to end the session."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rig.session.engine._conduct import conduct
from rig.session.engine._desk import Question, Reply
from rig.session.engine._directory import LOG
from rig.session.engine._log import read
from rig.session.engine._state import SessionState
from tests.rig.session.session_fakes import INVALID, FakeRunner, ScriptedDesk, protocol_of, started

STOPS: list[dict[str, Any]] = [{}, {"trials": 3}, {"minutes": 0.001}, {"aborts": 2}]


def run(
    directory: Path, runner: FakeRunner, answer: Callable[[Question], Reply | None], **sections: Any
) -> SessionState:
    with started(directory, protocol_of(**sections)) as session:
        return conduct(session, runner, ScriptedDesk(answer))


def end_with_redos(directory: Path, runner: FakeRunner, redos: int, **sections: Any) -> SessionState:
    """Return the state of a session at whose end the operator answers redo `redos` times in succession."""
    answered = 0

    def answer(question: Question) -> Reply | None:
        nonlocal answered
        wanted = question.text == "end the session?" or (0 < answered < redos and question.kind == "ready")
        if wanted and answered < redos and "redo" in question.actions:
            answered += 1
            return Reply(action="redo")
        return None

    state = run(directory, runner, answer, **sections)
    again = SessionState.of(read(directory / LOG))
    assert (again.trials, again.ended) == (state.trials, state.ended)
    return state


@pytest.mark.parametrize("redos", [1, 2])
@pytest.mark.parametrize("order", [{"kind": "fixed"}, {"kind": "fixed", "interleave": True}])
def test_a_trial_redone_after_a_stop_rule_comes_again(tmp_path: Path, redos: int, order: Any) -> None:
    runner = FakeRunner()
    state = end_with_redos(tmp_path, runner, redos, stop={"trials": 3}, order=order)
    assert state.ended == "3 trials"
    assert [trial.void for trial in state.trials] == [""] * (3 - redos) + ["redone"] * redos + [""] * redos
    walls = [(trial.run, trial.stiffness) for trial in state.trials]
    assert walls[3:] == walls[3 - redos : 3]


def test_redone_in_the_middle_does_not_count_towards_the_end(tmp_path: Path) -> None:
    ready = 0

    def answer(question: Question) -> Reply | None:
        nonlocal ready
        ready += question.kind == "ready"
        return Reply(action="redo") if question.kind == "ready" and ready == 2 else None

    state = run(tmp_path, FakeRunner(), answer, stop={"trials": 3})
    assert [trial.void for trial in state.trials] == ["redone", "", "", ""]


def test_only_a_trial_of_the_block_that_runs_can_be_redone(tmp_path: Path) -> None:
    offered: list[bool] = []

    def answer(question: Question) -> Reply | None:
        if question.text == "ready?":
            offered.append("redo" in question.actions)
        return None

    blocks = [trial.block for trial in run(tmp_path, FakeRunner(), answer, order={"repeats": 2}).trials]
    assert set(blocks) == {1, 2}
    assert offered == [before == block for before, block in zip([0, *blocks], blocks, strict=False)]


@pytest.mark.parametrize("stop", STOPS, ids=lambda stop: next(iter(stop), "none"))
def test_every_end_waits_for_what_was_redone(tmp_path: Path, stop: Any) -> None:
    cut = {"automatic": "unstable", "aborted": "energy"}
    runner = FakeRunner(dict.fromkeys((1, 2), (cut, None)) if "aborts" in stop else {})
    state = end_with_redos(tmp_path, runner, 1, stop=stop)
    void = [trial for trial in state.trials if trial.void]
    assert len(void) == 1
    after = state.trials[void[0].trial]
    assert (after.stiffness, after.run, after.void) == (void[0].stiffness, void[0].run, "")


def test_an_invalid_redone_trial_is_repeated_until_its_run_is_skipped(tmp_path: Path) -> None:
    """After the skip no repetition is due, and the stop rule ends the session."""

    def answer(question: Question) -> Reply | None:
        if question.text == "end the session?" and len(runner.hits) == 3:
            return Reply(action="redo")
        return Reply(action="skip") if question.kind == "trouble" else None

    runner = FakeRunner(dict.fromkeys(range(4, 20), (INVALID, None)))
    state = run(tmp_path, runner, answer, stop={"invalid": 3, "trials": 3})
    assert [trial.void for trial in state.trials[:3]] == ["", "", "redone"]
    assert state.skipped == {1}
    assert state.ended is not None
