"""Reasons of invalid trials, on the screen, in lines and in JSON: complete, and without the wall for blinded people."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.cli import run as rig
from rig.config import presets, verdict_thresholds
from rig.control import verdict
from rig.control._measure import NUMBERS
from rig.control.verdict import INVALID as MAKES_INVALID
from rig.control.verdict import Objection
from rig.core.errors import GuardError
from rig.core.present import plain
from rig.session.engine._conduct import conduct
from rig.session.engine._run import summary
from rig.session.planning._reasons import HIDDEN, RIG_LIMIT, summarise_reasons
from tests.rig.session.session_fakes import (
    INVALID,
    SPOILED,
    FakeRunner,
    ScriptedDesk,
    protocol_of,
    started,
    study,
)

THRESHOLDS = verdict_thresholds(presets.load("koul-rigid"))
OF_THE_RIG = Objection.SLEW_BOUND | Objection.IDLE_SATURATION
TELLING = {  # numbers that differ between walls or conditions
    "ticks": 41791,
    "slew_bound_ticks": 41792,
    "overruled_ticks": 41793,
    "settling_in_tail_s": 4179.4,
    "current_differs": 41795,
    "other_current_ticks": 41796,
}


def reason(objection: Objection, **changes: Any) -> str:
    numbers = np.zeros((), NUMBERS)
    for name, value in {**TELLING, **changes}.items():
        numbers[name] = value
    return verdict._TEXTS[objection](numbers[()], THRESHOLDS)


@pytest.mark.parametrize("objection", list(MAKES_INVALID), ids=lambda one: one.name)
def test_every_reason_is_shown_and_effort_only_as_a_rig_limit(objection: Objection) -> None:
    """A new or reworded reason stays hidden until a text for blinded people is defined."""
    text = reason(objection)
    shown = summarise_reasons([text], blind=True)
    assert shown != HIDDEN
    assert (shown == RIG_LIMIT) == bool(objection & OF_THE_RIG)
    assert not re.search(r"4179|calm|saturat|slew|settl|ripple", shown)
    assert summarise_reasons([text], blind=False) == text


def test_an_unknown_reason_is_hidden_and_one_without_signals_shown() -> None:
    assert summarise_reasons(["K = 412 is too much"], blind=True) == HIDDEN
    for text in ("a false start: the handle moved before the cue", "the run ended early: stopped"):
        assert summarise_reasons([text], blind=True) == text
    several = [reason(Objection.SLEW_BOUND), reason(Objection.IDLE_SATURATION), reason(Objection.TOO_SHORT)]
    assert summarise_reasons(several, blind=True) == f"{RIG_LIMIT}; the trial was too short"
    assert summarise_reasons([], blind=True) == ""


def invalid(*objections: Objection, **more: Any) -> dict[str, Any]:
    return {**INVALID, "reasons": [reason(one) for one in objections], **more}


@pytest.mark.parametrize("blind", ["both", "participant"])
def test_the_reason_is_shown_before_any_question(tmp_path: Path, blind: str) -> None:
    desk = ScriptedDesk()
    protocol = protocol_of(study=study(blind=blind), stop={"trials": 3})
    runner = FakeRunner({1: (invalid(Objection.LEFT, Objection.SLEW_BOUND), None)})
    with started(tmp_path / "P01", protocol) as session:
        conduct(session, runner, desk)
        result = summary(session.directory, session.state)
    first = next(view for view in desk.views if view.last.startswith("trial 1:"))
    if blind == "both":
        assert first.last == (
            "trial 1: invalid, will be repeated: the hand left the wall before the end and did not come back: ask to "
            "stay inside it; rig limit"
        )
        assert first.last in first.lines
    else:
        assert "left the calm wall" in first.last
        assert "the slew limit acted in 41792 ticks" in first.last
    assert (first.state, first.trial, first.attempt) == ("ready", 2, 2)
    assert first.say == f"Again. {protocol.trial.say}"
    assert "gain" not in protocol.trial.say
    assert {view.say for view in desk.views if view.state == "ready" and view.attempt == 1} == {
        protocol.trial.say
    }
    (line,) = result.invalid_trials
    assert line.startswith("trial 1: invalid, will be repeated: the hand left the wall")
    assert plain(result)["invalid_trials"] == [line]


def test_a_log_is_shown_as_text_and_json_with_walls_only_unblinded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    thrown = {"automatic": "unstable", "reasons": ["left the wall 3 times in the tail"]}
    fails: dict[int, Any] = {
        1: (invalid(Objection.TOUCHED_LATE, Objection.SLEW_BOUND), None),
        3: ({**thrown, "ended": "energy", "aborted": "energy"}, None),
    }
    with started(tmp_path / "P01", protocol_of(stop={"trials": 3})) as session:
        conduct(session, FakeRunner(fails), ScriptedDesk())

    def show(*options: str) -> str:
        assert rig(["session", "show", str(tmp_path / "P01"), *options]) == 0
        return capsys.readouterr().out

    blind = "trial 1: invalid, will be repeated: the wall was touched too late; rig limit"
    reported = json.loads(show("--json"))
    assert reported["invalid_trials"] == [blind]
    assert blind in [event["text"] for event in reported["events"]]
    assert blind in show("--log")
    assert not re.search(r"4179|slew|hidden|0\.37", show("--log") + json.dumps(reported))
    unblinded = show("--log", "--unblind")
    wall = r"[a-z]+-hidden, K = \d+ N·m/rad, B = 0\.37 N·m·s/rad"
    for line in (
        rf"trial 1, {wall}; automatic verdict invalid: the first contact lies in the tail; the slew limit acted",
        rf"trial 2, {wall}, attempt 2; automatic verdict",
        r"automatic verdict unstable: left the wall 3 times in the tail; ended early: energy\n",
    ):
        assert re.search(line, unblinded)
    assert '"stiffness"' in show("--json", "--unblind")


def test_no_question_and_no_pause_reveals_the_wall_to_a_blinded_operator(tmp_path: Path) -> None:
    """Questions come after the last allowed attempt, an early end, and trials that the computer spoiled."""
    spoiled = {**SPOILED, "reasons": [reason(Objection.GAPS), reason(Objection.OVERRULED)]}
    guarded = GuardError("the motor gave the handle 4179 J: the effort oscillated")
    ended = [
        "the run ended early: current differs",
        reason(Objection.CURRENT),
        reason(Objection.IDLE_SATURATION),
    ]
    fails: dict[int, Any] = {
        **dict.fromkeys((1, 2, 3), (invalid(Objection.IDLE_SATURATION, Objection.STILL_SETTLING), None)),
        4: ({**INVALID, "reasons": ended}, guarded),
        **dict.fromkeys(range(6, 12), (spoiled, None)),
    }
    desk = ScriptedDesk()
    with started(tmp_path / "P01", protocol_of(stop={"trials": 20})) as session:
        conduct(session, FakeRunner(fails), desk)
        result = summary(session.directory, session.state)
    asked = [question.text for question in desk.questions]
    assert any(
        re.search(r"3 trials in a row were invalid: rig limit; the trial was too short", text)
        for text in asked
    )
    assert any("ended early: current differs; the motor's current" in text for text in asked)
    assert any(
        "made 5 trials in a row invalid: from contact on, 0 % of the samples lost" in text for text in asked
    )
    seen = json.dumps([asked, [plain(view) for view in desk.views], plain(result)])
    assert not re.search(r"4179|calm|saturat|slew|oscillat", seen)
