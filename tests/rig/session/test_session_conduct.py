"""The session engine: order of trials, log, accepted answers, and what blinded people never see."""

import json
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rig.config.presets import load as preset
from rig.core.errors import ConfigError, GuardError, LinkLostError, OverrunError, StoppedError
from rig.core.present import plain
from rig.extras.study import analyse
from rig.session.engine._conduct import conduct
from rig.session.engine._desk import Question, Reply
from rig.session.engine._directory import LOG, Session, amend, event_of_trial, resume
from rig.session.engine._hits import heat_after
from rig.session.engine._log import Event, read
from rig.session.engine._rehearsal import Day, Person
from rig.session.engine._run import row_of, summary
from rig.session.engine._state import SessionState
from rig.session.engine._telling import line_of_event
from tests.rig.session.session_fakes import (
    INVALID,
    LOST,
    SPOILED,
    FakeRunner,
    ScriptedDesk,
    protocol_of,
    rehearsed,
    started,
    study,
)


def run_with(session: Session, runner: FakeRunner, desk: ScriptedDesk) -> SessionState:
    with session:
        return conduct(session, runner, desk)


def test_a_session_goes_through_all_runs_and_ends_complete(tmp_path: Path) -> None:
    runner, desk = FakeRunner(), ScriptedDesk()
    state = run_with(started(tmp_path / "P01"), runner, desk)
    assert state.ended == "complete"
    assert [trial.trial for trial in state.trials] == list(range(1, len(runner.hits) + 1))
    assert {trial.condition for trial in state.trials} == {"dual-hidden", "uniform-hidden"}
    assert {trial.verdict for trial in state.trials} == {"stable"}
    kinds = [event.kind for event in read(tmp_path / "P01" / LOG)]
    assert (kinds[0], kinds[1], kinds[-1]) == ("began", "opened", "ended")
    assert (tmp_path / "P01" / "protocol.toml").read_bytes() == b"# as it was\n"


def test_a_simulated_person_takes_as_long_before_a_trial_as_the_protocol_plans(tmp_path: Path) -> None:
    session = started(tmp_path / "P01", protocol_of(trial={"ready_s": 7.0}))
    rehearsed(session, FakeRunner(), Person(thresholds={}))
    events = read(tmp_path / "P01" / LOG)
    waited = [after.at - before.at for before, after in pairwise(events) if after.kind == "trial"]
    assert waited == pytest.approx([7.0 + 1.5] * len(waited))  # the rig's own seconds


class RealRunner(FakeRunner):
    simulated = virtual = False


def test_a_real_rig_is_pushed_before_each_block_and_not_armed_until_it_moves_as_described(
    tmp_path: Path,
) -> None:
    runner, desk = RealRunner(), ScriptedDesk()
    runner.moves = [False, True]
    state = run_with(started(tmp_path / "P01"), runner, desk)
    assert state.ended == "complete"
    assert len(runner.pulses) == 1 + len(state.blocks)
    events = read(tmp_path / "P01" / LOG)
    kinds = [event.kind for event in events]
    first = kinds.index("pulse")
    assert kinds[first : first + 4] == ["pulse", "paused", "continued", "pulse"]
    assert kinds.index("trial") > first + 3
    pushed = [event.content["block"] for event in events if event.kind == "pulse" and event.content["ok"]]
    assert pushed == [block.number for block in state.blocks]
    asked = [question.text for question in desk.questions]
    assert sum("hands off" in text for text in asked) == len(runner.pulses)
    assert any("does not move as it is described" in text and "`rig device check`" in text for text in asked)


def test_a_rig_that_was_left_is_pushed_again_and_a_simulated_one_never(tmp_path: Path) -> None:
    runner, desk = RealRunner(), ScriptedDesk(first("verdict", "abort"))
    session = started(tmp_path / "P01")
    run_with(session, runner, desk)
    before = len(runner.pulses)
    run_with(resume(tmp_path / "P01", clock=Day()), runner, ScriptedDesk())
    assert len(runner.pulses) == len(session.state.blocks) + before
    virtual = FakeRunner()
    run_with(started(tmp_path / "P02"), virtual, ScriptedDesk())
    assert virtual.pulses == []


@pytest.mark.parametrize(
    ("ended", "again"),
    [("device_fault", 1), ("current_differs", 1), ("device_contradicts", 1), ("energy", 0)],
)
def test_a_rig_that_a_trial_left_in_doubt_is_pushed_before_the_next(
    ended: str, again: int, tmp_path: Path
) -> None:
    """If the measured current differed from the set one, the motor must be tested again with a push."""
    runner = RealRunner({2: ({**INVALID, "ended": ended}, GuardError("ended early", remedy="look"))})
    session = started(tmp_path / "P01")
    run_with(session, runner, ScriptedDesk())
    kinds = [event.kind for event in read(tmp_path / "P01" / LOG)]
    assert len(runner.pulses) == len(session.state.blocks) + again
    second, third = [place for place, kind in enumerate(kinds) if kind == "trial"][1:3]
    assert kinds[second:third].count("pulse") == again


@pytest.mark.parametrize("blind", ["both", "operator"])
def test_a_blinded_operator_is_shown_no_condition_and_no_wall(tmp_path: Path, blind: str) -> None:
    protocol = protocol_of(
        study=study(blind=blind),
        question=[{"name": "tired", "text": "How tired?", "when": "block"}],
        stop={"trials": 5},
    )
    desk = ScriptedDesk()
    runner = FakeRunner({2: (INVALID, None), 3: ({"aborted": "energy"}, None)})
    lines: list[str] = []
    with started(tmp_path / "P01", protocol) as session:
        conduct(session, runner, desk, on_event=lambda event: lines.append(line_of_event(event)))
        result = summary(session.directory, session.state)
    seen = json.dumps(
        [
            [plain(view) for view in desk.views],
            [plain(question) for question in desk.questions],
            lines,
            plain(result),
            sorted(str(path) for path in tmp_path.rglob("*")),
        ]
    ).replace(str(tmp_path), "")  # whose directory has the number of a run: 450 is a stiffness
    for _, stiffness in runner.hits:
        assert f"{stiffness:g}" not in seen.replace("0.015", "")
    assert "hidden" not in seen
    assert "0.37" not in seen
    assert all(view.blinded for view in desk.views)


def test_an_unblinded_operator_sees_the_wall(tmp_path: Path) -> None:
    protocol = protocol_of(study=study(blind="participant"))
    desk = ScriptedDesk()
    runner = FakeRunner()
    run_with(started(tmp_path / "P01", protocol), runner, desk)
    assert {view.stiffness for view in desk.views if view.state == "go"} == {k for _, k in runner.hits}
    assert {"dual-hidden", "uniform-hidden"} <= {view.condition for view in desk.views}


@pytest.mark.parametrize("say", ["go", "skip"])
def test_after_as_many_attempts_as_are_allowed_the_operator_decides(tmp_path: Path, say: str) -> None:
    runner = FakeRunner(dict.fromkeys((1, 2, 3, 4), (INVALID, None)))
    desk = ScriptedDesk(
        lambda question: Reply(action=say) if question.kind == "trouble" else None  # type: ignore[arg-type]
    )
    state = run_with(started(tmp_path / "P01"), runner, desk)
    assert sum(question.kind == "trouble" for question in desk.questions) == 1
    if say == "go":
        assert [trial.attempt for trial in state.trials[:5]] == [1, 2, 3, 4, 5]
        assert not state.skipped
    else:
        assert state.skipped == {1}
        assert state.trials[3].run == 2


def first(kind: str, action: str, value: str = "") -> Callable[[Question], Reply | None]:
    """Return a desk function that gives one answer, to the first question of a kind."""
    answers_given: list[bool] = []

    def answer(question: Question) -> Reply | None:
        if question.kind == kind and not answers_given:
            answers_given.append(True)
            return Reply(action=action, value=value, took_s=0.5)  # type: ignore[arg-type]
        return None

    return answer


def test_a_redone_trial_stays_in_the_log_comes_again_and_does_not_count_towards_the_end(
    tmp_path: Path,
) -> None:
    runner, session = FakeRunner(), started(tmp_path / "P01", protocol_of(stop={"trials": 3}))
    state = run_with(session, runner, ScriptedDesk(first("verdict", "redo")))
    assert [trial.void for trial in state.trials] == ["redone", "", "", ""]
    assert state.trials[0].verdict == ""
    assert runner.hits[0][1] == runner.hits[1][1]


def test_a_note_and_a_pause_are_logged_and_the_question_asked_again(tmp_path: Path) -> None:
    replies = iter([Reply(action="note", value=" phone rang "), Reply(action="pause")])
    desk = ScriptedDesk(lambda question: next(replies, None) if question.kind == "ready" else None)
    state = run_with(started(tmp_path / "P01"), FakeRunner(), desk)
    assert state.notes == [(0, "phone rang")]
    assert [question.kind for question in desk.questions[:4]] == ["ready", "ready", "paused", "ready"]
    kinds = [event.kind for event in read(tmp_path / "P01" / LOG)]
    assert kinds[2:7] == ["block", "note", "paused", "continued", "trial"]


def test_a_block_may_start_over_without_what_was_skipped_in_it(tmp_path: Path) -> None:
    asked = 0

    def skip_and_leave(question: Question) -> Reply | None:
        nonlocal asked
        asked += question.kind == "ready"
        if question.kind == "ready" and asked in (4, 5):
            return Reply(action="skip" if asked == 4 else "abort")
        return None

    left = run_with(started(tmp_path / "P01"), FakeRunner(), ScriptedDesk(skip_and_leave))
    assert left.skipped == {1}
    with resume(tmp_path / "P01", at="block", clock=Day()) as session:
        assert session.state.skipped == set()
        state = conduct(session, FakeRunner(), ScriptedDesk())
    assert [trial.void for trial in state.trials[:4]] == [*["restarted"] * 3, ""]
    assert state.trials[3].trial == 4
    assert state.ended == "complete"


def test_unsure_asks_again_and_counts_as_not_stable_in_the_end(tmp_path: Path) -> None:
    asked = 0

    def unsure(question: Question) -> Reply | None:
        nonlocal asked
        asked += question.kind == "verdict"
        hesitates = question.kind == "verdict" and asked <= 3
        return Reply(action="judge", value="unsure", took_s=1.0) if hesitates else None

    runner = FakeRunner()
    state = run_with(started(tmp_path / "P01"), runner, ScriptedDesk(unsure))
    (run,) = (run for run in state.blocks[0].runs if run.number == 1)
    assert [answer.stable for answer in state.answers(run)[:4]] == [None, None, False, True]
    assert runner.hits[0][1] == runner.hits[1][1] == runner.hits[2][1] > runner.hits[3][1]


def test_the_automatic_verdict_may_lead_without_questions(tmp_path: Path) -> None:
    protocol = protocol_of(study=study(judge="automatic"))
    desk = ScriptedDesk()
    state = run_with(started(tmp_path / "P01", protocol), FakeRunner(), desk)
    assert not [question for question in desk.questions if question.kind == "verdict"]
    assert {(trial.stiffness < 430.0, trial.verdict, trial.judged_by) for trial in state.trials} <= {
        (True, "stable", "automatic"),
        (False, "buzz", "automatic"),
    }


def test_a_verdict_faster_than_a_person_is_reported_at_once_and_marked(tmp_path: Path) -> None:
    def answer(question: Question) -> Reply | None:
        took_s = {1: 0.012, 2: 0.1}.get(question.trial, 0.5)
        return Reply(action="judge", value="stable", took_s=took_s) if question.kind == "verdict" else None

    desk = ScriptedDesk(answer)
    state = run_with(started(tmp_path / "P01", protocol_of(stop={"trials": 4})), FakeRunner(), desk)
    assert [trial.too_fast for trial in state.trials] == [True, False, False, False]
    text = "trial 1: done, judged 12 ms after the question, sooner than trial.fastest_verdict_s"
    assert any(view.last.startswith(text) for view in desk.views)
    found = analyse([tmp_path])
    assert [row.too_fast for row in found.trials] == [True, False, False, False]
    assert any(one.startswith("1 verdict was given sooner than trial.fastest") for one in found.messages)
    for name, section in (
        ("automatic", {"study": study(judge="automatic")}),
        ("off", {"trial": {"fastest_verdict_s": 0.0}}),
    ):
        unmarked = protocol_of(stop={"trials": 4}, **section)
        state = run_with(started(tmp_path / name, unmarked), FakeRunner(), ScriptedDesk(answer))
        assert not any(trial.too_fast for trial in state.trials)


def test_rests_come_when_they_are_due(tmp_path: Path) -> None:
    protocol = protocol_of(
        rest={"every": 3, "seconds": 20.0, "between_blocks_s": 90.0},
        order={"kind": "fixed", "repeats": 2},
        stop={"trials": 24},
    )
    desk = ScriptedDesk()
    run_with(started(tmp_path / "P01", protocol), FakeRunner(), desk)
    events = read(tmp_path / "P01" / LOG)
    since = 0
    for before, event in pairwise(events):
        if event.kind == "trial":
            since += 1
            assert since <= 3
        if event.kind == "rested":
            assert event.content["reason"] == "block" or since == 3
            since = 0
        if event.kind == "block" and event.content["block"] == 2:
            assert (before.kind, before.content["seconds"]) == ("rested", 90.0)


def test_a_hot_motor_cools_before_the_next_trial(tmp_path: Path) -> None:
    runner, desk = FakeRunner(), ScriptedDesk()
    runner.heat_of_a_hit = 0.3
    state = run_with(started(tmp_path / "P01", protocol_of(stop={"trials": 6})), runner, desk)
    rests = [question for question in desk.questions if question.kind == "rest"]
    tau = preset("koul-rigid").rig.limits.thermal_time_constant_s
    assert rests
    assert rests[0].seconds == math.ceil(tau * math.log(0.6 / 0.25))
    assert all(trial.heat < 0.85 for trial in state.trials)


def test_heat_of_a_constant_load_is_the_closed_form() -> None:
    load, tick_s, tau = np.full(5000, 1.7), 1e-3, 4.0
    expected = 0.2 * math.exp(-5.0 / tau) + 1.7**2 * (1.0 - math.exp(-5.0 / tau))
    assert heat_after(0.2, load, tick_s, tau) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("stop", "fails", "reason"),
    [
        ({"trials": 4}, {}, "4 trials"),
        ({"invalid": 2}, {2: (INVALID, None), 3: (INVALID, None)}, "2 invalid trials in a row"),
        (
            {"aborts": 2},
            dict.fromkeys((2, 3), ({"aborted": "energy"}, None)),
            "2 hits in a row cut off",
        ),
        ({"minutes": 0.1}, {}, "0.1 minutes"),
    ],
)
def test_stop_rules_end_a_session(tmp_path: Path, stop: Any, fails: Any, reason: str) -> None:
    session = started(tmp_path / "P01", protocol_of(stop=stop))
    state = rehearsed(session, FakeRunner(fails), Person(thresholds={}))
    assert state.ended is not None
    assert state.ended.startswith(reason)


def test_questions_come_at_their_time_and_bad_answers_are_asked_again(tmp_path: Path) -> None:
    items = [
        {"name": "hand", "text": "Which?", "when": "start", "kind": "choice", "choices": ["left", "right"]},
        {"name": "tired", "text": "How tired?", "when": "block"},
        {"name": "remarks", "text": "Anything else?", "when": "end", "kind": "text"},
    ]
    answers = iter(["foot", "left", "8", "3", "no"])

    def answer(question: Question) -> Reply | None:
        return Reply(action="answer", value=next(answers)) if question.kind == "item" else None

    state = run_with(
        started(tmp_path / "P01", protocol_of(question=items)), FakeRunner(), ScriptedDesk(answer)
    )
    assert state.answered == {("hand", 0): "left", ("tired", 1): 3, ("remarks", -1): "no"}
    kinds = [event.kind for event in read(tmp_path / "P01" / LOG)]
    assert kinds[2] == "answered"
    assert kinds[-3:] == ["answered", "answered", "ended"]


def test_interleaved_runs_take_turns(tmp_path: Path) -> None:
    protocol = protocol_of(order={"kind": "fixed", "interleave": True})
    state = run_with(started(tmp_path / "P01", protocol), FakeRunner(), ScriptedDesk())
    runs = [trial.run for trial in state.trials]
    assert sum(a != b for a, b in pairwise(runs)) > 2
    assert {runs.count(1), runs.count(2)} != {0}


def test_a_lost_link_is_asked_about_after_the_effort_is_zero(tmp_path: Path) -> None:
    lost = LinkLostError("the link broke during the run")
    desk = ScriptedDesk()
    state = run_with(
        started(tmp_path / "P01"), FakeRunner({2: ({**INVALID, "ended": "link_closed"}, lost)}), desk
    )
    (trouble,) = (question for question in desk.questions if question.kind == "trouble")
    assert "the link broke" in trouble.text
    assert state.trials[1].ended == "link_closed"
    assert state.ended == "complete"


def test_a_person_sees_that_a_hit_was_cut_off_only_after_their_verdict(tmp_path: Path) -> None:
    cut = ({"automatic": "unstable", "aborted": "energy", "ended": "energy"}, None)
    seen: dict[str, str] = {}

    def answer(question: Question) -> Reply | None:
        text = json.dumps([plain(desk.views[-1]), plain(question)])
        if question.kind == "verdict" and question.trial == 2:
            seen["before"] = text
        if question.kind == "ready" and "before" in seen:
            seen.setdefault("after", text)
        return None

    desk = ScriptedDesk(answer)
    run_with(started(tmp_path), FakeRunner({2: cut}), desk)
    assert "trial 2: over" in seen["before"]
    assert not any(word in seen["before"] for word in ("cut off", "energy", "safety"))
    assert "trial 2: done, cut off for safety" in seen["after"]


def test_a_trial_is_left_out_afterwards_and_taken_back(tmp_path: Path) -> None:
    before = run_with(started(tmp_path / "P01"), FakeRunner(), ScriptedDesk())
    log = tmp_path / "P01" / LOG
    number = event_of_trial(tmp_path / "P01", 3, "void")
    assert (read(log)[number].kind, read(log)[number].content["trial"]) == ("trial", 3)
    written = amend(tmp_path / "P01", number, "void", "the table was bumped")
    assert line_of_event(written) == "trial 3 does not count (the table was bumped)"
    after = SessionState.of(read(log))
    assert [trial.trial for trial in after.trials if trial.void] == [3]
    run = next(run for block in after.blocks for run in block.runs if run.number == after.trials[2].run)
    assert len(after.judged_probes(run)) == len(before.judged_probes(run)) - 1
    assert after.ended == "complete"
    amend(tmp_path / "P01", number, "counts", "it was another table")
    assert SessionState.of(read(log)).trials == before.trials


def test_a_trial_that_was_left_out_comes_again_when_the_session_is_resumed(tmp_path: Path) -> None:
    def tired(question: Question) -> Reply | None:
        return Reply(action="abort") if question.kind == "ready" and len(desk.questions) > 4 else None

    desk = ScriptedDesk(tired)
    state = run_with(started(tmp_path / "P01"), FakeRunner(), desk)
    last = state.trials[-1]
    amend(tmp_path / "P01", event_of_trial(tmp_path / "P01", last.trial, "void"), "void", "the wrong hand")
    session = resume(tmp_path / "P01", clock=Day())
    assert (state.stopped, session.state.stopped) == ("the operator left", None)
    state = run_with(session, FakeRunner(), ScriptedDesk())
    assert state.trials[last.trial].stiffness == last.stiffness
    assert state.ended == "complete"


def test_a_trial_is_amended_by_its_number_and_impossible_corrections_are_refused(tmp_path: Path) -> None:
    run_with(started(tmp_path), FakeRunner({2: (INVALID, None)}), ScriptedDesk())
    events = read(tmp_path / LOG)
    written = amend(tmp_path, event_of_trial(tmp_path, 1, "buzz"), "buzz", "wrong key")
    assert read(tmp_path / LOG) == [*events, written]
    assert SessionState.of(read(tmp_path / LOG)).trials[0].verdict == "buzz"
    assert line_of_event(written) == "trial 1 corrected: buzz (wrong key)"
    for trial, value, reason in ((999, "void", "no trial 999"), (2, "buzz", "trial 2 has no verdict")):
        with pytest.raises(ConfigError, match=reason):
            event_of_trial(tmp_path, trial, value)
    assert events[4].kind == "judged"
    before = (tmp_path / LOG).read_bytes()
    for number, value, why, reason in (
        (event_of_trial(tmp_path, 1, "void"), "buzz", "x", "cannot be corrected to"),
        (10_000, "buzz", "x", "no event 10000"),
        (0, "buzz", "x", "cannot be corrected"),
        (4, "fine", "x", "is not a verdict"),
        (4, "buzz", " ", "needs a reason"),
    ):
        with pytest.raises(ConfigError, match=reason):
            amend(tmp_path, number, value, why)
        assert (tmp_path / LOG).read_bytes() == before


def test_a_participant_has_one_session_and_another_directory_none(tmp_path: Path) -> None:
    run_with(started(tmp_path / "P01"), FakeRunner(), ScriptedDesk())
    before = (tmp_path / "P01" / LOG).read_bytes()
    with pytest.raises(ConfigError, match="already contains a session"):
        started(tmp_path / "P01")
    with pytest.raises(ConfigError, match="has ended"):
        resume(tmp_path / "P01")
    assert (tmp_path / "P01" / LOG).read_bytes() == before
    for use in (resume, lambda place: amend(place, 3, "buzz", "x")):
        with pytest.raises(ConfigError, match=r"contains no file session\.log"):
            use(tmp_path)
    assert list(tmp_path.iterdir()) == [tmp_path / "P01"]


@pytest.mark.parametrize(("code", "row"), [("P01", 0), ("P12", 11), ("a7b03", 2)])
def test_the_number_in_a_code_is_the_row(code: str, row: int) -> None:
    assert row_of(code) == row
    with pytest.raises(ConfigError, match="`row`"):
        row_of("PX")


def test_a_stop_is_a_question_to_a_person_and_ends_a_rehearsal(tmp_path: Path) -> None:
    """After `rig stop` in a hit a rehearsal ends; a real operator is asked how to continue."""
    stop = StoppedError("stopped; the effort is zero")
    fails = {1: ({**INVALID, "ended": "stopped"}, stop)}
    with pytest.raises(StoppedError):
        rehearsed(started(tmp_path / "rehearsal"), FakeRunner(fails), Person(thresholds={}))
    desk = ScriptedDesk()
    state = run_with(started(tmp_path / "person"), FakeRunner(fails), desk)
    assert [question.kind for question in desk.questions[:3]] == ["ready", "trouble", "ready"]
    assert state.ended == "complete"


@pytest.mark.parametrize("rule", ["ascending", "staircase", "interleaved"])
def test_a_corrected_verdict_never_leads_to_a_wall_far_from_all_tried(tmp_path: Path, rule: str) -> None:
    settings = {"ascending": {"repeats": 2}, "staircase": {"most": 30}, "interleaved": {"most": 20}}[rule]
    protocol = protocol_of(
        search={"rule": rule, "lowest": 100.0, "highest": 800.0, "step": 50.0, "settings": settings},
        condition=[{"name": "one", "scheme": "dual:20k/2k", "damping": [0.3]}],
        stop={"trials": 12},
    )
    person = Person(thresholds={"one": 330.0}, spread=5.0)
    rehearsed(started(tmp_path / "P01", protocol), FakeRunner(), person)
    events = read(tmp_path / "P01" / LOG)
    judged = [event for event in events if event.kind == "judged"]
    for wrong in judged:
        value = "buzz" if wrong.content["verdict"] == "stable" else "stable"
        content = {"number": wrong.number, "field": "verdict", "value": value, "why": "wrong key"}
        amendment = Event(len(events), events[-1].at, "amended", content)
        state = SessionState.of([*events, amendment])
        (run,) = state.blocks[0].runs
        probe = state.asks(run)
        answers = state.answers(run)
        if probe is None:  # it has enough all the same
            continue
        near = [answer.probe.level for answer in answers if answer.stable] or [100.0]
        if not probe.catch and probe.track != 1:
            biggest = 50.0 if rule == "ascending" else 200.0
            start = 450.0 if rule == "staircase" else 100.0
            assert probe.level <= max(*near, start) + biggest


def test_a_correction_of_an_answer_is_checked_like_an_answer(tmp_path: Path) -> None:
    protocol = protocol_of(question=[{"name": "tired", "text": "How tired?", "when": "start"}])
    run_with(started(tmp_path / "P01", protocol), FakeRunner(), ScriptedDesk())
    number = next(event.number for event in read(tmp_path / "P01" / LOG) if event.kind == "answered")
    with pytest.raises(ConfigError, match="1 to 7"):
        amend(tmp_path / "P01", number, "banana", "a slip")
    assert amend(tmp_path / "P01", number, "5", "a slip").content["value"] == 5
    assert SessionState.of(read(tmp_path / "P01" / LOG)).answered["tired", 0] == 5


def test_a_finished_block_does_not_start_over(tmp_path: Path) -> None:
    protocol = protocol_of(rest={"between_blocks_s": 30.0}, order={"kind": "fixed", "repeats": 2})
    leaves = ScriptedDesk(lambda question: Reply(action="abort") if question.kind == "rest" else None)
    run_with(started(tmp_path / "P01", protocol), FakeRunner(), leaves)
    with resume(tmp_path / "P01", at="block", clock=Day()) as session:
        assert not [trial for trial in session.state.trials if trial.void]


def runner_spoiling(*trials: int) -> FakeRunner:
    return FakeRunner(dict.fromkeys(trials, (SPOILED, None)))


def test_a_trial_that_the_machine_spoils_is_repeated_and_counts_for_no_rule(tmp_path: Path) -> None:
    protocol = protocol_of(stop={"invalid": 2, "machine": 5}, trial={"attempts": 2})
    runner, desk = runner_spoiling(1, 2, 3, 4), ScriptedDesk()
    state = run_with(started(tmp_path / "P01", protocol), runner, desk)
    assert state.ended == "complete"
    assert [trial.attempt for trial in state.trials[:5]] == [1, 2, 3, 4, 5]
    assert len({stiffness for _, stiffness in runner.hits[:5]}) == 1
    assert not [question for question in desk.questions if question.kind in ("trouble", "paused")]
    assert (summary(tmp_path, state).invalid, summary(tmp_path, state).by_machine) == (4, 4)


def test_the_machine_neither_counts_among_invalid_trials_nor_parts_them(tmp_path: Path) -> None:
    runner = FakeRunner({1: (INVALID, None), 2: (SPOILED, None), 3: (INVALID, None)})
    state = run_with(started(tmp_path / "P01", protocol_of(stop={"invalid": 2})), runner, ScriptedDesk())
    assert (state.ended, state.newest) == ("2 invalid trials in a row", 3)


def test_a_machine_that_spoils_one_trial_after_another_pauses_the_session(tmp_path: Path) -> None:
    protocol, desk = protocol_of(stop={"machine": 3}), ScriptedDesk()
    state = run_with(started(tmp_path / "P01", protocol), runner_spoiling(2, 3, 4, 5, 6, 8, 9), desk)
    (asked,) = [question for question in desk.questions if question.kind == "paused"]
    assert f"made 3 trials in a row invalid: {LOST}; close other programs" in asked.text
    assert asked.actions == ("go", "note", "abort")
    events = read(tmp_path / "P01" / LOG)
    at = next(number for number, event in enumerate(events) if event.kind == "paused")
    kinds = [event.kind for event in events[at - 3 : at + 5]]
    assert kinds == [*["trial"] * 3, "paused", "continued", *["trial"] * 3]  # counted anew from there
    assert state.ended == "complete"
    assert SessionState.of(events).trials == state.trials


def test_a_rehearsal_ends_at_such_a_pause_and_is_resumed(tmp_path: Path) -> None:
    session, person = started(tmp_path / "P01", protocol_of(stop={"machine": 3})), Person(thresholds={})
    with pytest.raises(OverrunError, match="made 3 trials in a row invalid: from contact on") as ended:
        rehearsed(session, runner_spoiling(1, 2, 3, 4), person)
    assert ended.value.exit_code == 14
    assert "rig session resume" in ended.value.remedy
    kinds = [event.kind for event in read(tmp_path / "P01" / LOG)]
    assert kinds[-2:] == ["paused", "stopped"]
    state = rehearsed(resume(tmp_path / "P01", clock=Day()), runner_spoiling(4), person)
    assert state.ended == "complete"
    assert not state.skipped


def test_a_rehearsed_person_cannot_say_after_their_share_of_the_trials() -> None:
    trial: Any = SimpleNamespace(automatic="stable", condition="another", stiffness=1.0)
    person, drawn = Person(thresholds={}, unsure=0.25), np.random.default_rng(1)
    verdicts = [person.judge(trial, drawn) for _ in range(2000)]
    assert set(verdicts) == {"stable", "unsure"}
    assert verdicts.count("unsure") / len(verdicts) == pytest.approx(0.25, abs=0.03)


# Redo: a trial that does not count is repeated, also if a stop rule is about to end the session.


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

    state = run_with(started(directory, protocol_of(**sections)), runner, ScriptedDesk(answer))
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


def test_only_a_trial_of_the_block_that_runs_can_be_redone(tmp_path: Path) -> None:
    offered: list[bool] = []

    def answer(question: Question) -> Reply | None:
        if question.text == "ready?":
            offered.append("redo" in question.actions)
        return None

    session = started(tmp_path, protocol_of(order={"repeats": 2}))
    blocks = [trial.block for trial in run_with(session, FakeRunner(), ScriptedDesk(answer)).trials]
    assert set(blocks) == {1, 2}
    assert offered == [before == block for before, block in zip([0, *blocks], blocks, strict=False)]


@pytest.mark.parametrize("stop", [{}, {"minutes": 0.001}, {"aborts": 2}])
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
    state = run_with(
        started(tmp_path, protocol_of(stop={"invalid": 3, "trials": 3})), runner, ScriptedDesk(answer)
    )
    assert [trial.void for trial in state.trials[:3]] == ["", "", "redone"]
    assert state.skipped == {1}
    assert state.ended is not None
