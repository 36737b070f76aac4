"""Studies with known truth, from logs to tables: true effects are found, and excluded data has no influence."""

import json
import math
import runpy
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import rig.session as rig_session
from rig.cli import rig
from rig.config import as_mapping, override, presets
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError, RecordingError
from rig.extras.study import (
    AnalysisOptions,
    StudyAnalysis,
    analyse,
    analyse_study,
    read_study,
    write_study_tables,
)
from rig.extras.study import trials as trials_module
from rig.extras.study.cli_analyse import show
from rig.extras.study.trials import answers, half_way, levels
from rig.session.engine._log import SessionLog
from rig.session.search._rule import verdicts_of
from tests.conformance.studies import PRESET, VERSIONS, Person, protocol, sitting, without_sync, write_study
from tests.conformance.tiers import first_by_default

EXAMPLE = Path(rig_session.__file__).parent / "examples" / "from_tables.py"
UNIFORM, DUAL = 400.0, 460.0
OFFSETS = {"P01": -30.0, "P02": 35.0, "P03": 10.0, "P04": -15.0}


def person(offset: float = 0.0, **settings: Any) -> Any:
    return Person(
        threshold=lambda condition, damping: (
            (DUAL if condition == "dual" else UNIFORM) + offset + 20.0 * damping
        ),
        **settings,
    )


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Four people, two conditions, three repeats, up-down rule; some hits are invalid, some verdicts unsure."""
    where = tmp_path_factory.mktemp("study")
    people = {code: person(offset, invalid=0.05, unsure=0.03) for code, offset in OFFSETS.items()}
    write_study(where, protocol(search={"lowest": 300.0, "highest": 600.0, "step": 10.0}), people)
    return where


@pytest.fixture(scope="module")
def found(study: Path) -> Any:
    return analyse_study(str(study))


@pytest.fixture
def quick() -> Iterator[Any]:
    with without_sync():
        yield


def one_session(where: Any, mapping: Any = None, who: Any = None, **options: Any) -> Any:
    code = options.get("code", "P01")
    mapping = mapping or protocol(order={"repeats": 1})
    with sitting(where / code, mapping, who or person(), **options) as one:
        one.run()
    return analyse([where / code])


# ---------------------------------------------------------------------- what is there is found


def test_each_persons_limit_is_found(found: Any) -> None:
    for one in found.of_participants:
        truth = {"uniform": UNIFORM, "dual": DUAL}[one.condition] + OFFSETS[one.participant]
        if one.measure != "K50 automatic":
            assert abs(one.mean - truth) < 15.0
        if one.interval == "Student":
            assert one.student_low - 5.0 <= truth <= one.student_high + 5.0
        else:
            assert one.low < one.mean < one.high
            assert one.interval == ("verdicts" if one.measure != "rule" else one.interval)
    assert {one.repeats for one in found.of_participants} == {3}
    functions = [one for one in found.psychometrics if one.judge == "person" and one.participant]
    held = [
        one.threshold.low
        <= {"uniform": UNIFORM, "dual": DUAL}[one.condition] + OFFSETS[one.participant]
        <= one.threshold.high
        for one in functions
    ]
    assert len(held) == 8
    assert sum(held) >= 7


def test_there_is_one_k50_of_a_participant(found: Any) -> None:
    of_limits = {
        (one.participant, one.condition, one.measure): (one.mean, one.low, one.high)
        for one in found.of_participants
    }
    for one in found.psychometrics:
        k50 = one.threshold.mean, one.threshold.low, one.threshold.high
        if one.participant:
            assert of_limits[one.participant, one.condition, f"K50 {one.judge}"] == k50
        else:
            (over,) = [
                o
                for o in found.over_participants
                if (o.measure, o.condition) == (f"K50 {one.judge}", one.condition)
            ]
            assert (over.mean, over.low, over.high) == pytest.approx(k50)


def test_the_example_script_goes_from_the_tables_to_the_same_numbers(
    found: StudyAnalysis, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_study_tables(found, str(tmp_path))
    from_tables = SimpleNamespace(**runpy.run_path(str(EXAMPLE)))
    kmax = from_tables.limits(tmp_path)
    over = from_tables.over_participants(kmax).set_index("condition")
    for one in found.over_participants:
        if one.measure == "rule":
            theirs = over.loc[one.condition, ["kmax", "low", "high"]].tolist()
            assert theirs == pytest.approx([one.mean, one.low, one.high])
    (paired,) = from_tables.differences(kmax, ["uniform", "dual"]).to_dict("records")
    (ours,) = [one for one in found.paired if one.measure == "rule"]
    assert (paired["condition"], paired["against"]) == (ours.condition, ours.against)
    assert [paired[name] for name in ("difference", "low", "high", "p", "p_holm")] == pytest.approx(
        [ours.difference, ours.low, ours.high, ours.p, ours.holm]
    )
    (model,) = [one for one in found.mixed if one.measure == "rule"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a variance near zero
        theirs = from_tables.mixed_model(kmax)
        from_tables.main(tmp_path)
    assert theirs.fe_params["condition[T.uniform]"] == pytest.approx(-model.contrasts[0].difference, rel=1e-3)
    two = next(one for one in found.agreements if (one.name, one.condition) == ("two classes", ""))
    assert from_tables.kappa(tmp_path) == pytest.approx(two.kappa)
    assert f"kappa {two.kappa:.3f}" in capsys.readouterr().out


def test_every_trial_is_there_and_says_whether_it_counts(found: Any) -> None:
    assert len(found.trials) == sum(len(session.state.trials) for session in found.study.sessions)
    for trial in found.trials:
        assert (trial.void == "invalid") == (trial.automatic == "invalid")
        assert (trial.verdict == "") == (trial.void == "invalid")
        assert trial.recorded == "none"  # these are logs alone
    counts = found.counts()
    assert counts["recorded"] == counts["counted"] + counts["unsure"] + counts["invalid"]
    assert counts["unsure"] == sum(trial.verdict == "unsure" for trial in found.trials) > 0
    assert sum(run.trials for run in found.runs) == counts["counted"] + counts["unsure"]
    assert sum(one.counted for one in found.participants) == counts["counted"]
    assert {run.state for run in found.runs} == {"complete"}
    places = [run.place for run in found.runs if run.participant == "P01"]
    assert places == list(range(1, 7))


def test_differences_without_an_interval_are_counted_in_a_message(found: Any) -> None:
    assert not any("no interval and no p" in message for message in found.messages)
    alike = [
        replace(one, problem="the differences are alike") for one in found.paired if one.measure == "rule"
    ]
    messages = replace(found, paired=tuple(alike)).messages
    assert any(message.startswith("1 paired difference has no interval and no p") for message in messages)


@pytest.mark.parametrize("scheme", [None, "uniform:20k", "uniform:20k,cutoff_hz=1000"])
@pytest.mark.parametrize("cutoff", ["as-in-the-paper", "same"])
def test_a_scheme_has_the_settings_of_its_experiment(scheme: str | None, cutoff: str) -> None:
    experiment = override(presets.load(PRESET), {"controller.scheme_cutoff": cutoff})
    label = (Scheme.parse(scheme) if scheme else Scheme.of(experiment)).label(experiment)
    assert trials_module._scheme_words(scheme, as_mapping(experiment)["controller"]) == label


def test_the_rules_own_limit_is_what_the_rule_says_of_the_replayed_log(found: Any) -> None:
    session = found.study.sessions[0]
    runs = {run.number: run for block in session.state.blocks for run in block.runs}
    for row in found.runs:
        if row.participant == session.code:
            run = runs[row.run]
            estimate = session.state.rule(run).estimate(session.state.answers(run))
            assert row.limits["rule"].value == estimate.value
            grid = levels(session.state.protocol, run.condition)
            half = half_way(grid, verdicts_of(answers(session.state, run, "automatic")))
            assert row.limits["K50 automatic"] == half


def test_the_same_logs_give_the_same_numbers(tmp_path: Path) -> None:
    small = protocol(search={"step": 100.0}, order={"repeats": 1})
    write_study(tmp_path, small, {code: person(OFFSETS[code]) for code in ("P01", "P02", "P03")})
    found = analyse([tmp_path])
    again = analyse([tmp_path / "P02", tmp_path / "P01" / "session.log", tmp_path / "P03"])
    assert json.dumps(again.as_mapping()) == json.dumps(found.as_mapping())


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("rule", "settings"),
    first_by_default(
        [
            ("interleaved", {}),
            ("psi", {}),
            ("ascending", {"repeats": 3}),
            ("staircase", {"stable_to_rise": 2}),
            ("grid", {"repeats": 3}),
        ]
    ),
)
def test_every_rule_finds_the_same_half_way_point(tmp_path: Path, rule: str, settings: Any) -> None:
    share = 0.0 if rule == "psi" else 0.2
    mapping = protocol(
        search={"rule": rule, "settings": settings, "lowest": 200.0, "highest": 700.0, "catch_share": share},
        order={"repeats": 2, "blocks": "one", "interleave": True, "kind": "fixed"},
    )
    found = one_session(tmp_path, mapping, person(lapse_rate=0.0))
    for run in found.runs:
        truth = DUAL if run.condition == "dual" else UNIFORM
        limit = run.limits["K50 person"]
        assert limit.low - 10.0 <= truth <= limit.high + 10.0
        # Each series has one end to count.
        assert abs(limit.value - truth) < (90.0 if rule == "ascending" else 30.0)
        assert (run.limits["rule"].share is None) == (rule == "ascending")
    caught = sum(run.catches for run in found.runs)
    assert (caught > 0) == (share > 0.0)
    assert sum(run.lapses for run in found.runs) == 0
    assert caught == sum(trial.catch for trial in found.trials) == found.counts().get("catch trials", 0)


@pytest.mark.usefixtures("quick")
def test_kinds_of_slips_are_counted_apart_and_a_wall_that_holds_is_no_slip(tmp_path: Path) -> None:
    """A person for whom the stiffest wall is stable also answers so on its catch trials."""
    interleaved = {"rule": "interleaved", "settings": {"most": 20}, "catch_share": 0.4}
    once = {"repeats": 1}
    low = protocol(search={**interleaved, "highest": 300.0}, order=once)
    found = one_session(tmp_path / "a", low, person())
    assert {run.limits["rule"].censored for run in found.runs} == {"above"}
    assert all(run.caught.stiff == run.lapses == 0 for run in found.runs)
    assert sum(run.caught.soft for run in found.runs) > 0
    found = one_session(tmp_path / "b", protocol(search=interleaved, order=once), person(lapse_rate=0.3))
    write_study_tables(found, tmp_path)
    (row,) = pq.read_table(tmp_path / "participants.parquet").to_pylist()
    for name, field in (("soft_catches", "soft"), ("stiff_catches", "stiff")):
        assert row[name] == sum(getattr(run.caught, field) for run in found.runs) > 0
    for name in ("false_unstable", "false_stable"):
        assert row[name] == sum(getattr(run.caught, name) for run in found.runs)
    (one,) = found.participants
    assert one.caught.lapses == row["false_unstable"] + row["false_stable"] > 0


@pytest.mark.usefixtures("quick")
def test_an_ascending_series_that_failed_at_once_is_noted_and_bounds_nothing(tmp_path: Path) -> None:
    """The first verdict of the session is a lapse; the later series locate the limit."""
    mapping = protocol(search={"rule": "ascending", "settings": {"repeats": 3}}, order={"repeats": 1})
    judged = []

    def threshold(_condition: Any, _damping: Any) -> Any:
        judged.append(True)
        return 1.0 if len(judged) <= 2 else 410.0  # the automatic verdict asks too

    found = one_session(tmp_path, mapping, Person(threshold=threshold, spread=1e-3))
    slipped, plain = found.runs
    assert slipped.note == "1 of 3 series failed at the softest wall, which is used as their limit"
    assert (plain.note, plain.limits["rule"].value) == ("", 400.0)
    limit = slipped.limits["rule"]
    assert (limit.value, limit.censored) == (300.0, "")  # 100, 400 and 400
    assert not any("amended" in message for message in found.messages)


# ---------------------------------------------------------------------- what must not count


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("rule", first_by_default(["staircase", "interleaved"]))
def test_a_search_that_ended_by_most_is_marked_and_left_out_unless_asked_for(
    rule: str, tmp_path: Path
) -> None:
    mapping = protocol(
        search={"rule": rule, "settings": {"turns": 6, "most": 3}, "step": None, "ratio": 1.1},
        order={"repeats": 1},
    )
    people = {f"P0{n}": person(40.0 * n) for n in range(1, 4)}
    write_study(tmp_path, mapping, people)
    found = analyse([tmp_path])
    assert {run.state for run in found.runs} == {"ended by most"}
    for run in found.runs:
        assert "ended by most after 0 of 6 turns" in run.note
        assert "rule" not in run.limits or run.limits["rule"].mark in run.note
    assert found.of_participants == found.paired == ()
    assert any(
        "6 runs were stopped at the trial limit (search.settings.most), excluded from K_max" in message
        for message in found.messages
    )
    assert found.counts()["in searches stopped at the trial limit"] == len(found.trials)
    taken = analyse([tmp_path], AnalysisOptions(include_marked=True))
    assert any(one.marked for one in taken.over_participants)
    write_study_tables(taken, tmp_path / "out")
    runs = pq.read_table(tmp_path / "out" / "runs.parquet").to_pylist()
    assert {row["state"] for row in runs} == {"ended by most"}
    assert all(row["limit_rule_mark"] for row in runs if row["limit_rule_n_m_per_rad"] is not None)
    result = CliRunner().invoke(rig, ["session", "analyse", str(tmp_path), "--no-report", "--include-marked"])
    assert result.exit_code == 0, result.output
    assert " *" in result.output


@pytest.mark.usefixtures("quick")
def test_redone_and_restarted_trials_are_flagged_and_do_not_count(tmp_path: Path) -> None:
    mapping = protocol(practice={"stiffness": [200.0, 300.0]})
    with sitting(tmp_path / "P01", mapping, person()) as one:
        one.run(trials=6)
        one.record("redone", trial=6)
        one.run(trials=4)
        one.record("resumed", where="block", abandoned=[])
        one.record("restarted", block=1)
        one.run()
    found = analyse([tmp_path])
    void = {trial.trial: trial.void for trial in found.trials if trial.void}
    assert void == {**dict.fromkeys((3, 4, 5, 7, 8, 9, 10), "restarted"), 6: "redone"}
    assert [trial.trial for trial in found.trials if trial.practice] == [1, 2]
    assert sum(run.trials for run in found.runs) == len(found.trials) - 8 - 2
    assert sum(run.voided for run in found.runs) == 8
    assert {run.state for run in found.runs} == {"complete"}
    (first,) = [block for block in found.blocks if block.block == 1]
    assert first.redone == 1


@pytest.mark.usefixtures("quick")
def test_an_amended_verdict_counts_and_withdraws_the_limit_of_the_rule(tmp_path: Path) -> None:
    """A staircase's walls follow from earlier answers: K50 uses the correction, the rule's limit cannot."""
    before = one_session(tmp_path)
    judged = next(e for e in before.study.sessions[0].of_kind("judged") if e.content["trial"] == 5)
    other = "buzz" if judged.content["verdict"] == "stable" else "stable"
    with SessionLog(tmp_path / "P01" / "session.log") as log:
        log.append("amended", number=judged.number, field="verdict", value=other, why="a slip of the key")
    after = analyse([tmp_path])
    trial = after.trials[4]
    assert (trial.verdict, trial.amended, trial.void) == (other, True, "")
    assert sum(trial.amended for trial in after.trials) == 1
    changed = [(b, a) for b, a in zip(before.runs, after.runs, strict=True) if a != b]
    ((was, now),) = changed
    assert was.run == trial.run
    assert set(now.limits) == {"K50 person", "K50 automatic"}
    assert now.limits["K50 person"] != was.limits["K50 person"]
    assert now.limits["K50 automatic"] == was.limits["K50 automatic"]
    assert "amended" in now.note
    assert any("amended" in message for message in after.messages)
    with SessionLog(tmp_path / "P01" / "session.log") as log:  # and back again: the last correction holds
        value = judged.content["verdict"]
        log.append("amended", number=judged.number, field="verdict", value=value, why="it was right")
    assert [run.limits for run in analyse([tmp_path]).runs] == [run.limits for run in before.runs]


@pytest.mark.usefixtures("quick")
def test_a_trial_left_out_afterwards_is_flagged_and_its_run_stays_complete(tmp_path: Path) -> None:
    before = one_session(tmp_path)
    event = next(e for e in before.study.sessions[0].of_kind("trial") if e.content["trial"] == 5)
    with SessionLog(tmp_path / "P01" / "session.log") as log:
        log.append("amended", number=event.number, field="void", value=True, why="bumped", trial=5)
    after = analyse([tmp_path])
    assert {trial.trial: trial.void for trial in after.trials if trial.void} == {5: "left out"}
    run = next(one for one in after.runs if one.run == after.trials[4].run)
    was = next(one for one in before.runs if one.run == run.run)
    assert (run.state, run.trials, run.voided) == ("complete", was.trials - 1, 1)
    assert "K50 person" in run.limits
    assert run.limits["K50 person"] != was.limits["K50 person"]
    assert sum(block.redone for block in after.blocks) == 0


@pytest.mark.usefixtures("quick")
def test_skipped_and_unfinished_runs_stay_in_their_table_and_out_of_the_limits(tmp_path: Path) -> None:
    with sitting(tmp_path / "P01", protocol(), person()) as one:
        one.run(trials=3)
        one.record("skipped", run=1)
        one.run(trials=5)
        one.record("stopped", reason="the operator left")
    found = analyse([tmp_path])
    assert [run.state for run in found.runs] == ["skipped", "unfinished"]
    assert found.of_participants == found.over_participants == found.psychometrics == ()
    assert any("not complete" in message for message in found.messages)
    assert any("1 run was skipped" in message for message in found.messages)
    assert found.counts() == {"recorded": 8, "in skipped searches": 3, "in unfinished searches": 5}
    assert all("participants" in model.problem for model in found.mixed)


@pytest.mark.usefixtures("quick")
def test_answers_are_columns_of_the_table_of_participants(tmp_path: Path) -> None:
    items = [
        {"name": "tired", "text": "How tired?", "when": "start"},
        {"name": "hard", "text": "How hard?", "when": "block"},
        {"name": "remarks", "text": "Anything else?", "kind": "text"},
    ]
    with sitting(tmp_path / "P01", protocol(question=items, order={"repeats": 2}), person()) as one:
        one.run()
    found = analyse([tmp_path])
    assert [(a.item, a.when, a.block) for a in found.answers] == [
        ("tired", "start", 0),
        ("hard", "block", 1),
        ("hard", "block", 2),
        ("remarks", "end", 0),
    ]
    write_study_tables(found, tmp_path / "out")
    (row,) = pq.read_table(tmp_path / "out" / "participants.parquet").to_pylist()
    assert (row["answer_tired"], row["answer_remarks"], row["ended"]) == (1, "1", "complete")
    assert "answer_hard" not in row
    assert (row["trials"], row["active_s"]) == (len(found.trials), 10.0 * len(found.trials))


# ---------------------------------------------------------------------- degenerate data


@pytest.mark.usefixtures("quick")
def test_walls_that_all_hold_are_limits_beyond_the_levels(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mapping = protocol(search={"highest": 300.0, "step": 50.0})
    write_study(tmp_path, mapping, {code: person(offset) for code, offset in OFFSETS.items()})
    found = analyse([tmp_path])
    assert {run.limits["rule"].censored for run in found.runs} == {"above"}
    assert {(one.above, one.runs, one.mean) for one in found.over_participants if one.measure == "rule"} == {
        (12, 12, 300.0)
    }
    assert (
        next(model for model in found.mixed if model.measure == "rule").problem
        == "most limits lie beyond the searched levels"
    )
    assert not any(one.bounded for one in found.psychometrics)
    assert {(one.above, one.below, one.threshold.mean) for one in found.psychometrics if one.participant} == {
        (1, 0, 300.0)
    }
    (k50,) = {one.limits["K50 person"].high for one in found.runs}
    assert math.isinf(k50)
    write_study_tables(found, tmp_path / "out")
    (row, *_) = pq.read_table(tmp_path / "out" / "runs.parquet").to_pylist()
    assert row["limit_k50_person_high_n_m_per_rad"] is None
    assert row["limit_k50_person_low_n_m_per_rad"] <= row["limit_k50_person_n_m_per_rad"] == 300.0
    show(found)
    text = capsys.readouterr().out
    assert "≥ 300" in text
    assert "No mixed model: most limits lie beyond the searched levels" in text
    assert "12 of 12" in " ".join(found.messages)
    assert all(math.isnan(one.p) and one.withheld for one in found.paired)


@pytest.mark.usefixtures("quick")
def test_before_the_first_verdict_there_is_nothing_but_a_table_of_trials(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with sitting(tmp_path / "P01", protocol(), person(invalid=1.0)) as one:
        for _ in range(3):
            one.step()
    found = analyse([tmp_path])
    assert found.counts() == {"recorded": 2, "invalid": 2}
    assert found.of_participants == found.agreements == found.psychometrics == found.mixed == ()
    assert [run.limits for run in found.runs] == [{}]
    write_study_tables(found, tmp_path / "out")
    assert pq.read_table(tmp_path / "out" / "kmax.parquet").num_rows == 0
    show(found)
    text = capsys.readouterr().out
    assert "No complete run has a limit" in text


@pytest.mark.usefixtures("quick")
def test_where_the_rig_judges_there_is_no_person_to_agree_with(tmp_path: Path) -> None:
    found = one_session(tmp_path, protocol(study={"judge": "automatic"}))
    assert found.agreements == ()
    assert all(set(run.limits) == {"rule", "K50 automatic"} for run in found.runs)
    assert {run.followed for run in found.runs} == {"automatic"}
    assert all(one.judge == "automatic" for one in found.psychometrics)


# ---------------------------------------------------------------------- what belongs together


@pytest.mark.usefixtures("quick")
def test_sessions_of_different_studies_are_refused(tmp_path: Path) -> None:
    def begin(code: Any, mapping: Any, **options: Any) -> None:
        with sitting(tmp_path / code, mapping, person(), code=code, **options) as one:
            one.run(trials=1)

    begin("P01", protocol())
    begin("P02", protocol(search={"step": 50.0}), row=1)
    with pytest.raises(
        ConfigError, match=r"the protocols of the sessions differ: search\.step \(25.0: P01; 50.0: P02\)"
    ):
        read_study(str(tmp_path))
    begin("P03", protocol(study={"participants": 20, "title": "Another name"}, rest={"every": 9}), row=2)
    begin("P04", protocol(), row=2, versions={**VERSIONS, "haptic-rig": "0.2.0"})
    messages = " ".join(read_study([tmp_path / code for code in ("P01", "P03", "P04")]).messages)
    assert "P03 and P04 both have row 2 of the plan" in messages
    assert "the version of haptic-rig (0.1.0: P01, P03; 0.2.0: P04)" in messages
    begin("P05", protocol(), row=4, rehearsal={"spread": 15.0})
    with pytest.raises(
        ConfigError, match="P05: rehearsals with a simulated person cannot be analysed together with people"
    ):
        read_study([tmp_path / "P01", tmp_path / "P05"])
    with sitting(tmp_path / "again" / "P01", protocol(), person()) as one:
        one.run(trials=1)
    with pytest.raises(ConfigError, match="participant P01 has two sessions"):
        read_study([tmp_path / "P01", tmp_path / "again"])


@pytest.mark.usefixtures("quick")
def test_a_session_without_a_trial_is_left_out_and_named(tmp_path: Path) -> None:
    with sitting(tmp_path / "P01", protocol(), person()) as one:
        one.run(trials=1)
    with sitting(tmp_path / "P02", protocol(), person(), code="P02", rehearsal={"spread": 15.0}):
        pass
    study = read_study([tmp_path])
    assert [session.code for session in study.sessions] == ["P01"]
    assert study.messages[0] == f"ignored sessions without a trial: {tmp_path / 'P02'}"


@pytest.mark.usefixtures("quick")
def test_missing_and_changed_recordings_are_reported(tmp_path: Path) -> None:
    with sitting(tmp_path / "P01", protocol(), person(), recorded=True) as one:
        one.run(trials=4)
    trials = tmp_path / "P01" / "trials"
    (trials / "t0002.parquet").unlink()
    (trials / "t0003.parquet").write_bytes(b"another")
    found = analyse([tmp_path])
    assert [trial.recorded for trial in found.trials] == ["ok", "missing", "changed", "ok"]
    messages = " ".join(found.messages)
    assert "1 recording is missing (trial 2)" in messages
    assert "1 recording is changed (trial 3)" in messages
    unchecked = analyse([tmp_path], AnalysisOptions(hashes=False))
    assert [trial.recorded for trial in unchecked.trials] == [
        "not checked",
        "missing",
        "not checked",
        "not checked",
    ]


def test_a_damaged_log_and_an_empty_place_are_refused(tmp_path: Path, study: Path) -> None:
    with pytest.raises(RecordingError, match="no session found in"):
        read_study([tmp_path])
    copy = tmp_path / "P01" / "session.log"
    copy.parent.mkdir()
    whole = (study / "P01" / "session.log").read_bytes()
    copy.write_bytes(whole.replace(b'"verdict": "stable"', b'"verdict": "buzz"  ', 1))
    with pytest.raises(RecordingError, match="damaged"):
        read_study([tmp_path])
    copy.write_bytes(whole[:-20])  # a last line that a dying process left: no harm
    assert len(read_study([tmp_path]).sessions[0].state.trials) > 50


# ---------------------------------------------------------------------- tables and command


def test_tables_say_their_units_and_are_alike_in_both_forms(found: Any, tmp_path: Path) -> None:
    written = write_study_tables(found, tmp_path)
    dictionary = json.loads((tmp_path / "tables.json").read_text())["tables"]
    assert set(written) == {f"{name}.{kind}" for name in dictionary for kind in ("csv", "parquet")} | {
        "tables.json"
    }
    for name, described in dictionary.items():
        table = pq.read_table(tmp_path / f"{name}.parquet")
        assert (table.column_names, table.num_rows) == (list(described["columns"]), described["rows"])
        types = pa_csv.ConvertOptions(column_types=table.schema, strings_can_be_null=True)
        read = pa_csv.read_csv(tmp_path / f"{name}.csv", convert_options=types).to_pylist()
        assert read == [
            {key: None if value == "" else value for key, value in row.items()} for row in table.to_pylist()
        ]
        for field in table.schema:
            assert field.metadata[b"unit"].decode() == described["columns"][field.name]["unit"]
            assert described["columns"][field.name]["meaning"]
    assert dictionary["trials"]["columns"]["stiffness_n_m_per_rad"]["unit"] == "N·m/rad"
    assert dictionary["trials"]["columns"]["response_time_s"]["unit"] == "s"
    kmax = pq.read_table(tmp_path / "kmax_over_participants.parquet").to_pylist()
    assert [row["kmax_n_m_per_rad"] for row in kmax] == [one.mean for one in found.over_participants]


def test_a_table_of_confusions_says_what_its_interval_is_over_and_who_is_in_it(
    found: Any, tmp_path: Path
) -> None:
    write_study_tables(found, tmp_path)
    row = next(r for r in pq.read_table(tmp_path / "agreement.parquet").to_pylist() if r["condition"] == "")
    two = found.agreements[0]
    assert (row["people"], row["left_out"], row["same"]) == (4, two.left_out, two.share)
    assert row["kappa_low"] is None
    assert "4 people" in row["problem"]
    assert (row["positive"], row["negative"]) == (two.positive, two.negative)
    differences = pq.read_table(tmp_path / "differences.parquet").to_pylist()
    assert {row["method"] for row in differences} == {"paired", "mixed"}
    assert {(row["bound"], row["beyond"]) for row in differences} == {("", 0)}


def test_the_command_writes_beside_the_sessions(
    tmp_path: Path, found: StudyAnalysis, capsys: pytest.CaptureFixture[str]
) -> None:
    small = protocol(search={"step": 100.0}, order={"repeats": 1})
    write_study(tmp_path, small, {"P01": person(), "P02": person()})
    command = ["session", "analyse", str(tmp_path), "--no-report", "--json", "--measure", "k50-person"]
    printed = CliRunner().invoke(rig, command)
    assert printed.exit_code == 0, printed.output
    result = json.loads(printed.stdout)
    assert (result["measure"], len(result["runs"])) == ("K50 person", 4)
    assert Path(result["tables"]["kmax.csv"]) == tmp_path / "analysis" / "kmax.csv"
    show(found)
    text = capsys.readouterr().out
    for part in ("A study: 4 participants", "dual − uniform", "two classes", "Slopes along the session"):
        assert part in text
