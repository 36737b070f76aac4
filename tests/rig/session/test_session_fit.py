"""Parts that an operator must fit to the rig for a condition: stated in the protocol, confirmed in the session."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rig import config
from rig.config import Experiment, presets
from rig.core.board import describe
from rig.core.check import Check
from rig.core.errors import ConfigError, PlanError
from rig.core.same_rig import check_rig
from rig.session.engine._desk import Question, Reply
from rig.session.engine._directory import LOG, amend, resume
from rig.session.engine._fitting import refuse_misfit
from rig.session.engine._log import read
from rig.session.engine._state import DoTrial, SessionState
from rig.session.planning._conditions import Walls
from rig.session.planning._protocol import Protocol
from tests.rig.session.session_fakes import FakeRunner, ScriptedDesk, protocol_of, started
from tests.rig.session.test_session_conduct import run_with

DAMPER = "an eddy-current damper"
DAMPED = {"rig.mechanics.link_damping": 0.02}


def factorial(**order: Any) -> Protocol:
    rates = [
        {"name": f"{bare} {rate}", "scheme": f"uniform:{rate}"}
        for bare in ("bare", "damped")
        for rate in ("2k", "4k")
    ]
    fitted = [one | ({"fit": DAMPER, "changes": DAMPED} if "damped" in one["name"] else {}) for one in rates]
    return protocol_of(condition=fitted, order={"kind": "fixed", "blocks": "condition", **order})


class Helper(ScriptedDesk):
    """An operator who confirms each fitting as requested, and leaves after so many trials."""

    def __init__(self, leaves_after: int = 1000) -> None:
        super().__init__(self.helps)
        self.leaves_after = leaves_after

    def helps(self, question: Question) -> Reply | None:
        if question.kind == "item" and question.item is not None:
            return Reply(action="answer", value=question.item["choices"][0])
        done = sum(one.kind == "verdict" for one in self.questions)
        return Reply(action="abort") if question.kind == "ready" and done >= self.leaves_after else None

    @property
    def requests(self) -> list[str]:
        return [one.text for one in self.questions if one.kind == "item"]


def test_the_session_asks_for_what_a_block_needs_and_for_nothing_that_is_there(tmp_path: Path) -> None:
    desk, session = Helper(), started(tmp_path / "P01", factorial())
    state = run_with(session, FakeRunner(), desk)
    assert state.ended == "complete"
    assert desk.requests == [f"Fit to the rig: {DAMPER}."]
    assert state.answered == {}  # it is no question of the study's
    kinds = [(event.kind, event.content.get("block")) for event in session.log.events]
    assert kinds.index(("answered", 3)) < kinds.index(("block", 3))
    last_first = replace(factorial(), condition=factorial().condition[::-1])
    desk = Helper()
    run_with(started(tmp_path / "P02", last_first), FakeRunner(), desk)
    assert desk.requests == [f"Fit to the rig: {DAMPER}.", f"Take off the rig: {DAMPER}."]


def test_a_corrected_answer_changes_nothing_of_what_was_done(tmp_path: Path) -> None:
    run_with(started(tmp_path / "P01", factorial()), FakeRunner(), Helper(leaves_after=20))
    log = tmp_path / "P01" / LOG
    (number,) = (event.number for event in read(log) if event.kind == "answered")
    amend(tmp_path / "P01", number, "the other damper", why="the first one was broken")
    assert isinstance(SessionState.of(read(log)).next(), DoTrial)


def test_a_resumed_session_asks_again_for_the_fitted_part(tmp_path: Path) -> None:
    desk = Helper(leaves_after=3)
    assert run_with(started(tmp_path / "P01", factorial()), FakeRunner(), desk).stopped
    desk = Helper()
    state = run_with(resume(tmp_path / "P01"), FakeRunner(), desk)
    assert state.ended == "complete"
    assert desk.requests == ["Take off what was fitted to the rig.", f"Fit to the rig: {DAMPER}."]


def test_a_changed_part_of_the_machine_needs_a_fit_and_blocks_by_condition() -> None:
    with pytest.raises(ConfigError) as caught:
        protocol_of(condition=[{"name": "damped", "changes": DAMPED}])
    assert "condition 1.changes.rig.mechanics.link_damping = 0.02" in str(caught.value)
    assert "condition 1.fit does not say which part has to be fitted" in str(caught.value)
    with pytest.raises(ConfigError, match=r'order.blocks = "repeat": must be "condition"'):
        factorial(blocks="repeat")


def test_a_device_of_another_encoder_is_refused_with_what_to_do() -> None:
    """A board has its encoder resolution in its firmware, so no setting can change it."""
    base = presets.load("koul-rigid")
    board = describe(
        config.rig_model(base), firmware="1", simulated=False, rate_default=4000, rate_maximum=20000
    )

    class Board(FakeRunner):
        def fits(self, experiment: Experiment, changes: Mapping[str, Any]) -> Any:
            found: list[Check] = [check_rig(config.rig_model(experiment), board)]
            return found

    coarse = {"name": "coarse", "fit": "the coarse encoder", "changes": {"rig.encoder.decoding": 1}}
    order = {"kind": "fixed", "blocks": "condition"}
    both = protocol_of(condition=[{"name": "fine"}, coarse], order=order)
    with pytest.raises(PlanError, match="built for another rig") as caught:
        refuse_misfit(Walls(both, base), Board())
    assert "run conditions with another encoder as a separate study" in caught.value.remedy
    refuse_misfit(Walls(factorial(), base), Board())  # of a damper a board knows nothing
