"""Allowed bands of impact speed and press: values outside, their consequences and reasons, and the simulated hand."""

import json
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from rig.config import push_at_rest
from rig.core.check import Outcome
from rig.core.present import plain
from rig.core.sample import Phase
from rig.extras.study import analyse
from rig.extras.study.report_methods import methods
from rig.extras.study.tables import tables
from rig.session.engine._check import check
from rig.session.engine._conduct import conduct
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import Event, read
from rig.session.engine._rehearsal import Person
from rig.session.engine._run import rehearsal_desk, run_session, summary
from rig.session.engine._telling import outcome, whole_line
from rig.session.planning._bands import judge_bands, press_of
from rig.session.planning._conditions import Walls
from rig.session.planning._load import load_walls
from rig.session.planning._protocol import Trial
from rig.session.planning._simulated_hand import reach_for, simulate_hits
from rig.session.planning._trial import HitOutcome
from rig.session.terminal import _words as words
from tests.conformance.studies import hit_outcome
from tests.rig.session.session_fakes import FakeRunner, ScriptedDesk, protocol_of, started, study

BOTH = Trial(impact_speed=(0.2, 0.4), press=(0.15, 0.25))
FAST = "hit too fast: 0.5 rad/s (required: 0.2 to 0.4 rad/s)"
HARD = "pressed too hard: 0.3 N·m (required: 0.15 to 0.25 N·m)"
STUDY = """
[study]
title = "bands"
preset = "koul-compliant"
changes = {"trial.minimum_rest_counts" = 0.0}
[[condition]]
name = "slow"
scheme = "uniform:2k"
damping = [0.1]
[search]
rule = "grid"
lowest = 40.0
highest = 160.0
ratio = 2.0
settings.repeats = 1
[trial]
baseline_s = 0.1
foreperiod_s = 0.2
duration_s = 3.0
hold_s = 0.7
impact_speed = [0.2, 0.4]
press = [0.17, 0.23]
"""


def hit(automatic: str = "stable", **numbers: float | None) -> HitOutcome:
    return hit_outcome(automatic, numbers={"impact_velocity": 0.3, "press": 0.2, **numbers})


@pytest.mark.parametrize(
    ("one", "outside"),
    [
        (hit(), ()),
        (hit(impact_velocity=0.5), (FAST,)),
        (hit(impact_velocity=-0.5), (FAST,)),  # a wall on the other side
        (hit(impact_velocity=0.2, press=0.25), ()),  # the ends belong to it
        (hit(impact_velocity=0.1), ("hit too slowly: 0.1 rad/s (required: 0.2 to 0.4 rad/s)",)),
        (hit(press=0.3), (HARD,)),
        (hit("limit cycle", impact_velocity=0.5, press=0.3), (FAST, HARD)),
        (hit("unstable", press=0.3), ()),  # there the effort is the wall's own
        (hit("unstable", impact_velocity=0.5, press=0.3), (FAST,)),
        (hit(impact_velocity=None), ()),  # not measurable
        (hit("invalid", impact_velocity=0.5), ()),  # it says nothing anyhow
    ],
)
def test_a_hit_outside_is_invalid_or_kept_as_in_the_protocol(
    one: HitOutcome, outside: tuple[str, ...]
) -> None:
    found = judge_bands(one, BOTH, "rotary")
    assert found.outside == outside
    assert (found.automatic, found.reasons) == (("invalid", outside) if outside else (one.automatic, ()))
    assert found.passes == (dict.fromkeys(one.passes) if outside else one.passes)
    kept = judge_bands(one, replace(BOTH, outside="keep"), "rotary")
    assert kept == replace(one, outside=outside)


def test_without_bands_nothing_lies_outside() -> None:
    assert judge_bands(hit(impact_velocity=9.0, press=9.0), Trial(), "rotary") == hit(
        impact_velocity=9.0, press=9.0
    )


@pytest.mark.parametrize("side", [1, -1])
def test_the_press_is_the_mean_effort_into_the_wall_over_the_judged_tail(walls: Walls, side: int) -> None:
    x = walls.softest(walls.protocol.condition[0])
    x = replace(x, wall=replace(x.wall, side=side))
    tail = round(x.verdict.tail_s * x.controller.position_rate)
    rows = np.zeros(3 * tail, [("phase", "i8"), ("effort_sent", "f8")])
    rows["phase"][:tail] = Phase.FREE
    assert press_of(cast("Any", SimpleNamespace(rows=rows[:tail])), x) is None
    rows["phase"][tail:] = Phase.TRIAL
    rows["effort_sent"][tail:] = side * 9.0  # the impact, which is not judged
    rows["effort_sent"][2 * tail :: 2] = side * -0.5  # a limit cycle
    rows["effort_sent"][2 * tail + 1 :: 2] = side * 0.1
    assert press_of(cast("Any", SimpleNamespace(rows=rows)), x) == pytest.approx(0.2)


def session_with(tmp_path: Path, **trial: Any) -> tuple[ScriptedDesk, Any, list[Event]]:
    """Run three trials, the first hit too fast and pressed too hard; return desk, result and log events."""
    numbers = {"impact_velocity": 0.3, "press": 0.2}
    fails: dict[int, Any] = {number: ({"numbers": numbers}, None) for number in range(2, 9)}
    fails[1] = ({"numbers": {"impact_velocity": 0.5, "press": 0.3}}, None)
    desk = ScriptedDesk()
    bands = {"impact_speed": [0.2, 0.4], "press": [0.15, 0.25], "hold_s": 0.7, **trial}
    changes = {"trial.minimum_rest_counts": 0.0, "operator.press": 2.0, "operator.reach_s": 0.3}
    protocol = protocol_of(study=study(changes=changes), trial=bands, stop={"trials": 3})
    with started(tmp_path / "P01", protocol) as session:
        conduct(session, FakeRunner(fails), desk)
        result = summary(session.directory, session.state)
    return desk, result, read(tmp_path / "P01" / "session.log")


def test_a_hit_outside_is_repeated_and_a_blinded_operator_reads_no_effort(tmp_path: Path) -> None:
    desk, result, events = session_with(tmp_path)
    first = next(view for view in desk.views if view.last)
    assert first.last == f"trial 1: invalid, will be repeated: {FAST}; pressed too hard: ask to press less"
    assert (first.trial, first.attempt, first.say[:7]) == (2, 2, "Again. ")
    assert {view.asked for view in desk.views} == {"impact speed 0.2 to 0.4 rad/s, press 0.15 to 0.25 N·m"}
    assert (result.invalid, result.outside, result.trials) == (1, 1, 3)
    assert ("asked", first.asked) in words.facts(first)
    (trial,) = [one for one in events if one.kind == "trial" and one.content["trial"] == 1]
    assert trial.content["outside"] == [FAST, HARD]
    assert HARD in whole_line(trial, "rotary")
    assert "0.3 N·m" not in json.dumps([plain(view) for view in desk.views])


def test_a_hit_that_is_kept_is_judged_and_marked_after_its_verdict_alone(tmp_path: Path) -> None:
    """If the press were judged before the person's verdict, it would reveal that the wall was not unstable."""
    desk, result, events = session_with(tmp_path, outside="keep")
    assert (result.invalid, result.outside, result.trials) == (0, 1, 3)
    asked = [view for view in desk.views if view.state == "verdict?"]
    assert asked[0].last == "trial 1: over"
    assert any(
        view.last == f"trial 1: done, counts, but {FAST}; pressed too hard: ask to press less"
        for view in desk.views
    )
    assert not any("ask to press less" in line for view in desk.views for line in view.lines)
    (trial,) = [one for one in events if one.kind == "trial" and one.content["trial"] == 1]
    assert trial.content["automatic"] == "stable"
    assert f"counts, but {FAST}; {HARD}" in whole_line(trial, "rotary")
    found = analyse([tmp_path])
    assert outcome(found.trials[0], blind=False).endswith(f"counts, but {FAST}; {HARD}")
    (table,) = [one for one in tables(found) if one.name == "trials"]
    (column,) = [one for one in table.columns if one.name == "outside"]
    assert [column.of(row) for row in table.rows] == [f"{FAST}; {HARD}", "", ""]
    task = {paragraph.heading: paragraph.text for paragraph in methods(found)}["Task"]
    assert "asked for: impact speed 0.2 to 0.4 rad/s, press 0.15 to 0.25 N·m" in task
    assert "1 of 3 trials lay outside and were kept, marked in the table of trials" in task


@pytest.fixture(scope="module")
def walls(tmp_path_factory: pytest.TempPathFactory) -> Walls:
    path = tmp_path_factory.mktemp("bands") / "study.toml"
    path.write_text(STUDY)
    found = load_walls(path)
    return Walls(found.protocol, found.base, reach_for)


def test_a_simulated_hand_aims_at_the_middle_whichever_wall_comes_first(walls: Walls) -> None:
    (condition,) = walls.protocol.condition
    soft, stiff = (walls.at(condition, 0.1, stiffness) for stiffness in (40.0, 160.0))
    assert push_at_rest(soft) == pytest.approx(0.2)
    assert push_at_rest(stiff) == pytest.approx(0.2)
    does = simulate_hits(soft)
    assert fmean(does["impact_speed"]) == pytest.approx(0.3, rel=0.1)
    assert fmean(does["press"]) == pytest.approx(0.2, rel=0.1)
    again = Walls(walls.protocol, walls.base, reach_for)
    assert again.at(condition, 0.1, 160.0) == stiff
    assert again.at(condition, 0.1, 40.0) == soft


def test_a_rehearsal_keeps_within_the_bands(walls: Walls, tmp_path: Path) -> None:
    path, person = tmp_path / "study.toml", Person(thresholds={})
    path.write_text(STUDY)
    result = run_session(
        path, "P01", rehearsal_desk(person), runner=DeviceRunner(), study=tmp_path, person=person
    )
    trials = [event.content for event in read(tmp_path / "P01" / "session.log") if event.kind == "trial"]
    assert len(trials) == 3
    assert (result.outside, result.invalid) == (0, 0)
    for one in trials:
        assert one["numbers"]["press"] == pytest.approx(0.2, rel=0.1)
        assert 0.2 < one["numbers"]["impact_velocity"] < 0.4


def test_the_plan_warns_of_a_band_that_the_simulated_hand_does_not_keep(walls: Walls) -> None:
    found = {one.name: one for one in check(walls.protocol, Path()).checks}
    assert found["trial.press"].outcome is Outcome.OK
    assert found["trial.impact_speed"].outcome is Outcome.OK
    changes = {**walls.protocol.study.changes, "operator.press": 1.0, "operator.reach_s": 0.1}
    # Given by the study: it stays.
    own = replace(walls.protocol, study=replace(walls.protocol.study, changes=changes))
    found = {one.name: one for one in check(own, Path()).checks}
    assert found["trial.press"].outcome is Outcome.WARNING
    assert "required 0.17 to 0.23 N·m" in found["trial.press"].text
    assert found["trial.impact_speed"].outcome is Outcome.WARNING
    assert "operator.reach_s" in found["trial.impact_speed"].remedy
