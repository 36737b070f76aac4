"""The check of a study before its first session: what it counts and rejects, without any device."""

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig import devices
from rig.cli import run
from rig.config import override
from rig.core.check import Check, Outcome
from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.experiments.trials.plan import predict_impact
from rig.session.engine._check import check
from rig.session.engine._device_checks import device_checks
from rig.session.engine._directory import LOG
from rig.session.engine._hits import DeviceRunner
from rig.session.planning import _disk as disk
from rig.session.planning._conditions import Walls, base_of
from rig.session.planning._disk import refuse_full_disk
from rig.session.planning._expected import ExpectedRange, expected_trials
from rig.session.planning._load import as_mapping, load_protocol
from rig.session.planning._plan import StudyPlan
from rig.session.planning._protocol import Caps, Condition, Practice, Protocol, Rest, Search, Stop
from rig.session.planning._schedule import levels_of
from rig.session.planning._template_files import DEFAULT, template_names, write_template
from rig.session.planning._times import QUESTION_S, heat_of, trial_times
from tests.conformance.studies import Person, sitting, without_sync, write_study
from tests.conformance.tiers import first_by_default


def template(name: str, folder: Path) -> Protocol:
    write_template(name, folder / "study.toml")
    return load_protocol(folder / "study.toml")


@pytest.fixture(scope="module")
def schemes(tmp_path_factory: pytest.TempPathFactory) -> Protocol:
    found = template("compare-schemes", tmp_path_factory.mktemp("study"))
    return replace(found, search=replace(found.search, ratio=1.3))  # few levels, because each one is planned


@pytest.fixture(scope="module")
def plan(schemes: Protocol) -> StudyPlan:
    return check(schemes, Path())


def check_named(plan: StudyPlan, name: str) -> Check:
    (found,) = [one for one in plan.checks if one.name == name]
    return found


@pytest.mark.parametrize("name", first_by_default(sorted(template_names(), key=lambda name: name != DEFAULT)))
def test_every_template_passes_on_its_preset(name: str, tmp_path: Path) -> None:
    found = check(template(name, tmp_path), tmp_path, participants=2)
    assert found.ok, [one for one in found.checks if one.outcome is Outcome.REFUSED]
    assert check_named(found, "expected limits").outcome is Outcome.OK
    assert all(one.levels[0] < one.expected.limit.likely < one.levels[-1] for one in found.cells)
    names = [one.name for one in found.checks]
    assert len(names) == len(set(names))
    assert 0 < found.trials.least <= found.trials.likely <= found.trials.most
    assert len(found.orders) == 2
    json.dumps(plain(found))


def test_a_plan_counts_runs_trials_and_times(plan: StudyPlan, schemes: Protocol) -> None:
    assert (plan.runs, plan.blocks, plan.practice, plan.rows, plan.participants) == (4, 2, 3, 2, 8)
    per_search = sum(cell.trials.count.likely for cell in plan.cells)
    assert plan.trials.likely == pytest.approx(2 * per_search + 3)
    # lower limits and upper limits of the parts add up to those of the whole
    assert plan.session_s.most == pytest.approx(sum(part.most for part in plan.duration_s.values()))
    assert plan.duration_s["questions"].likely == 2 * QUESTION_S
    assert plan.duration_s["hits"].likely == pytest.approx(
        plan.trials.likely * (plan.trial.hit + plan.trial.release)
    )
    assert plan.trial.hit == 1.0
    assert len(plan.orders) == 8
    assert {name for order in plan.orders for block in order for name in block} == {
        one.name for one in schemes.condition
    }


def test_theory_says_which_levels_are_unstable_in_a_hand_and_free(plan: StudyPlan) -> None:
    from rig.analysis import theory  # noqa: PLC0415

    for cell in plan.cells:
        scheme = "uniform:20k,cutoff_hz=1000" if "uniform" in cell.condition else "dual:20k/2k"
        for hand in ("normal", "relaxed"):
            own = theory.k_max("koul-compliant", scheme, cell.damping, operator=hand).stiffness
            assert cell.expected.by_hand[hand] == pytest.approx(own)
        softest = min(value for hand, value in cell.expected.by_hand.items() if hand != "none")
        assert cell.unstable_in_hand == tuple(k for k in cell.levels if k > softest)
        assert cell.expected.limit.least < cell.expected.limit.likely < cell.expected.limit.most
        held = [value for hand, value in cell.expected.by_hand.items() if hand != "none"]
        assert cell.expected.limit.most == 2.5 * max(held)  # friction


def test_unsuitable_settings_are_warned_of_or_refused(schemes: Protocol, plan: StudyPlan) -> None:
    """Each plan has several unsuitable settings, which its checks name apart."""
    likely = max(cell.expected.limit.likely for cell in plan.cells)
    least = max(cell.expected.limit.least for cell in plan.cells)
    study, order = schemes.study, schemes.order
    above = Search(lowest=100.0, highest=0.9 * likely, ratio=1.15)
    below = Search(lowest=1.1 * likely, highest=1.6 * likely, ratio=1.05)
    assert least < above.highest
    many = replace(order, repeats=20)
    wrong: list[dict[str, Any]] = [
        {"search": above, "caps": Caps(), "order": replace(order, kind="fixed"), "stop": Stop(trials=10)},
        {"search": below, "caps": Caps(), "study": replace(study, participants=7), "stop": Stop(minutes=0.5)},
        {"stop": Stop(trials=round(plan.trials.likely))},
        {"order": many, "rest": Rest(), "stop": Stop()},
    ]
    expected = [
        {"expected limits": Outcome.WARNING, "order": Outcome.WARNING, "stop.trials": Outcome.REFUSED},
        {"expected limits": Outcome.WARNING, "order": Outcome.WARNING, "stop.minutes": Outcome.REFUSED},
        {"stop.trials": Outcome.WARNING},
        {"rest": Outcome.WARNING},
    ]
    for changes, outcomes in zip(wrong, expected, strict=True):
        found = check(replace(schemes, **changes), Path())
        assert {name: check_named(found, name).outcome for name in outcomes} == outcomes


@pytest.mark.parametrize("rule", first_by_default(["staircase", "interleaved"]))
def test_a_largest_number_of_verdicts_that_cannot_hold_the_turns_is_warned_of(
    schemes: Protocol, rule: str
) -> None:
    """Three verdicts cannot contain six turns in any search; sixty can in every search."""
    found = {}
    for most in (3, 60):
        wanted = replace(schemes.search, rule=rule, settings={"turns": 6, "most": most})
        checks = check(replace(schemes, search=wanted), Path()).checks
        found[most] = [one for one in checks if one.name == "search.settings.most"]
    ((warning,), nothing) = found[3], found[60]
    assert warning.outcome is Outcome.WARNING
    assert "15 of 15" in warning.text
    assert nothing == []


def test_a_cap_that_can_never_act_is_warned_of(schemes: Protocol, plan: StudyPlan) -> None:
    assert not [one for one in plan.checks if one.name.startswith("caps.")]
    found = check(replace(schemes, caps=replace(schemes.caps, energy=5000.0, stiffness=1e9)), Path())
    assert check_named(found, "caps.energy").outcome is Outcome.WARNING
    assert check_named(found, "caps.stiffness").outcome is Outcome.WARNING


def test_the_space_for_recordings_is_estimated_and_checked(
    schemes: Protocol, plan: StudyPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert 5e5 < plan.trial_bytes < 3e6  # 1 to 1.4 MB were measured at 20 kHz
    searched = plan.trials.likely - plan.practice
    assert plan.disk_bytes.likely == pytest.approx(searched * plan.trial_bytes)
    base, place = base_of(schemes, Path()), tmp_path / "sessions" / "not yet"
    refuse_full_disk(Walls(schemes, base), 0, place)
    monkeypatch.setattr(disk.shutil, "disk_usage", lambda _: SimpleNamespace(free=int(10e6)))
    with pytest.raises(ConfigError, match=r"has 10 MB of free space; .* of about .* trials need"):
        refuse_full_disk(Walls(schemes, base), 0, place)


def test_a_wall_that_no_plan_allows_is_refused_with_its_condition(schemes: Protocol) -> None:
    narrow = {**schemes.study.changes, "rig.limits.position_maximum": 0.004}
    found = check(replace(schemes, study=replace(schemes.study, changes=narrow)), Path())
    refused = check_named(found, "after the wall")
    assert refused.outcome is Outcome.REFUSED
    assert "21 of 21 walls" in refused.text
    assert "uniform 20 kHz, K = 100 N·m/rad" in refused.text
    assert not found.ok


def test_the_worst_of_many_walls_is_reported(plan: StudyPlan, schemes: Protocol) -> None:
    base = base_of(schemes, Path())
    walls = [
        Walls(schemes, base).at(condition, 0.2, level)
        for condition in schemes.condition
        for level in levels_of(schemes.search)
    ]
    limited = [x for x in walls if predict_impact(x).peak_effort > x.rig.limits.effort]
    assert limited
    assert walls[0] not in limited
    effort = check_named(plan, "peak effort")
    assert effort.outcome is Outcome.WARNING
    assert f"for example uniform 20 kHz, K = {limited[0].wall.stiffness:g} N·m/rad" in effort.text


def test_a_device_is_asked_for_its_rate_only_when_it_is_named(
    schemes: Protocol, plan: StudyPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The device here is not a process, but has the highest rate of one that is simulated in real time."""
    assert not [one for one in plan.checks if one.name == "device rate"]
    with devices.open_device("sim://koul-compliant") as slow:
        slow._dictionary = replace(slow.dictionary, position_rate_maximum=4000)
        monkeypatch.setattr(DeviceRunner, "_device", lambda *_: slow)
        asked = check_named(check(schemes, Path(), of_device=partial(device_checks, "sim://")), "device rate")
    assert asked.outcome is Outcome.REFUSED  # in real time, as a session with a person runs it
    assert "20000 Hz" in asked.text
    assert "rehearse" in asked.remedy


def test_a_condition_without_theory_has_a_note(schemes: Protocol) -> None:
    own = Condition(name="other law", damping=(0.1,), changes={"wall.law": "bilateral"})
    found = check(replace(schemes, condition=(*schemes.condition, own), practice=Practice()), Path())
    assert found.cells[-1].expected.by_hand
    levant = Condition(name="levant", scheme="dual:20k/2k,estimator=levant", damping=(0.1,))
    found = check(replace(schemes, condition=(levant,), practice=Practice()), Path())
    assert "theory uses" in found.cells[0].expected.note


@pytest.mark.exhaustive("::test_a_plan_counts_runs_trials_and_times")
def test_the_times_of_people_who_have_finished_replace_the_planned_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Unfinished and rehearsed sessions do not count; here trials take 8 s and verdicts 2 s."""
    planned = template(DEFAULT, tmp_path)
    table = as_mapping(planned)
    person = Person(threshold=lambda *_: 100.0)
    write_study(tmp_path, table, {"P01": person, "P02": person})
    write_study(tmp_path, table, {"P03": person}, rehearsal={})
    with without_sync(), sitting(tmp_path / "P04", table, person, code="P04", row=3) as one:
        one.run(trials=3)
    (tmp_path / "P05").mkdir()
    (tmp_path / "P05" / LOG).write_text("no log")
    assert check(planned, tmp_path, study=tmp_path / "missing").trial.ready == 3.0
    found = check(planned, tmp_path, study=tmp_path)
    assert found.taken is not None
    assert found.taken.sessions == 2
    assert found.taken.trials == 2 * (found.trials.likely - found.practice)
    assert found.trial.verdict == pytest.approx(2.0)
    assert found.trial.total == pytest.approx(found.taken.trial + 2.0)
    people = found.duration_s["ready and verdict"]
    assert people.likely == pytest.approx(found.trials.likely * (found.trial.ready + 2.0))
    assert run(["session", "check", str(tmp_path / "study.toml"), "--study", str(tmp_path)]) == 0
    text = (
        f"medians of {found.taken.trials} trials in 2 finished sessions, instead of the times in the protocol"
    )
    assert text in capsys.readouterr().out
    other = replace(planned, trial=replace(planned.trial, hold_s=0.9))  # other trials take another time
    assert check(other, tmp_path, study=tmp_path).taken is None


# Trials


@pytest.mark.parametrize(
    ("rule", "settings", "hits"), [("psi", {"hits": 17}, 17), ("psi", {}, 25), ("grid", {"repeats": 3}, 27)]
)
def test_rules_of_fixed_length_take_that_many(rule: Any, settings: dict[str, Any], hits: int) -> None:
    search = Search(lowest=100.0, highest=900.0, step=100.0, rule=rule, settings=settings)
    found = expected_trials(search, ExpectedRange(200.0, 400.0, 600.0))
    assert found.count == ExpectedRange(hits, hits, hits)
    assert 0 < found.failures.least < found.failures.most < hits


def test_a_ladder_costs_more_the_higher_the_limit_lies() -> None:
    search = Search(lowest=100.0, highest=900.0, step=20.0, rule="ascending", settings={"repeats": 3})
    low, high = (expected_trials(search, ExpectedRange(k, k, k)).count.likely for k in (200.0, 600.0))
    assert 3 * 2 < low < 3 * 8 < high < 3 * 27


# Heat


def heat(schemes: Protocol, trials: int, share: float) -> Any:
    base = base_of(schemes, Path())
    x = override(Walls(schemes, base).at(schemes.condition[0], 0.1, 200.0), {"operator.press": 1.5})
    times = trial_times(x, ready_s=3.0, verdict_s=2.0)
    return heat_of(x, times, trials, share), times, x


def test_heat_settles_where_a_hit_gives_what_the_pause_takes(schemes: Protocol) -> None:
    found, times, x = heat(schemes, 5000, 1.0)
    tau = x.rig.limits.thermal_time_constant_s
    settled = found.after_one / (1.0 - math.exp(-times.total / tau))
    assert found.peak == pytest.approx(settled)
    assert x.trial.hold_s > 0.0
    assert times.hit == pytest.approx(x.operator.begin_s + 0.5 * x.operator.reach_s + x.trial.hold_s)
    assert found.after_one == pytest.approx(found.load**2 * -math.expm1(-x.trial.hold_s / tau))
    assert (found.first_pause, found.pauses, found.cooling_s) == (0, 0, 0.0)


@settings(max_examples=25)
@given(st.floats(0.001, 1.0), st.integers(1, 400))
def test_the_motor_begins_no_hit_warmer_than_it_may(schemes: Protocol, share: float, trials: int) -> None:
    found, _, _ = heat(schemes, trials, share)
    assert found.peak <= share + found.after_one
    assert (found.first_pause > 0) == (found.pauses > 0) == (found.cooling_s > 0.0)
    assert found.pauses < trials


def test_a_wall_has_the_seed_of_the_study(schemes: Protocol) -> None:
    """Trials use the same seed, so a simulated device started for the checks also serves the trials."""
    seeded = replace(schemes, study=replace(schemes.study, seed=3))
    walls = Walls(seeded, base_of(seeded, Path()))
    assert {walls.softest(one).trial.seed for one in seeded.condition} == {3}
