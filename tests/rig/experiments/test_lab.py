"""The public Python functions: presets, files or experiments, settings by name, a lab's laws and estimators."""

import sys
import threading
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rig
from rig import config
from rig.core import plugins
from rig.core.errors import ConfigError, RecordingError
from rig.core.sample import Phase
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest
from rig.experiments.hits.hit import hit as run
from rig.experiments.trials.plan import delay_checks
from tests.conformance.own_parts import blend, stiffening

SHORT: dict[str, Any] = {"duration_s": 0.25, "changes": {"verdict.tail_s": 0.1}}


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> rig.HitResult:
    place = tmp_path_factory.mktemp("own")
    law = stiffening().with_parameters(quadratic=2e4)
    return rig.hit("koul-compliant", law=law, estimator=blend(), stiffness=100.0, output=place, **SHORT)


def test_a_preset_a_file_and_an_experiment_give_the_same_hit(tmp_path: Path) -> None:
    """All of them equal the hit that the command line makes."""
    file = tmp_path / "mine.toml"
    file.write_text('preset = "koul-compliant"\n')
    assert rig.load("koul-compliant") == rig.load(file)
    results = [rig.hit(str(file), stiffness=200.0, output=tmp_path, name="a", **SHORT)]
    changes = {"wall.stiffness": 200.0, "trial.duration_s": 0.25, "verdict.tail_s": 0.1}
    results += run(HitRequest(experiment=rig.load("koul-compliant"), changes=changes, output=tmp_path), admit)
    assert results[0].experiment == results[1].experiment
    assert results[0].recording.rows.tobytes() == results[1].recording.rows.tobytes()
    assert results[0].path != results[1].path, "none is overwritten"


def test_settings_have_the_names_of_keys_and_a_wrong_one_names_those_that_are_near() -> None:
    loaded = rig.load(
        "koul-rigid", damping=0.25, position_rate=500, velocity_rate=500, operator="firm", seed=7
    )
    assert (loaded.wall.damping, loaded.controller.position_rate, loaded.trial.seed) == (0.25, 500, 7)
    assert (loaded.trial.kind, loaded.operator.grip) == ("human", "firm")
    assert rig.load(loaded, operator="none").trial.kind == "constant-effort"
    assert rig.load(loaded, changes={"wall.position": 0.01}).wall.position == 0.01
    for call in (rig.load, rig.hit, rig.plan):
        with pytest.raises(ConfigError, match=r"unknown setting 'stifness'; did you mean stiffness\?"):
            call("koul-rigid", stifness=1.0)  # type: ignore[operator]
    with pytest.raises(ConfigError, match=r"unknown setting 'colour'; choose one of: side, pull"):
        rig.hit(colour="red")  # type: ignore[call-arg]
    with pytest.raises(ConfigError, match=r"wall.stiffness = -1.0: must be a number ≥ 0 N·m/rad"):
        rig.load("koul-rigid", stiffness=-1.0)
    with pytest.raises(ConfigError, match=r"koul-complaint.*did you mean koul-compliant\?"):
        rig.hit("koul-complaint")


def test_a_hit_gives_one_result_and_can_be_watched(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"trial.repeats = 2: .*; give repeats=1"):
        rig.hit(repeats=2, output=tmp_path)
    assert not list(tmp_path.iterdir())
    seen: list[tuple[int, int]] = []

    def watch(number: int, experiment: rig.Experiment) -> Any:
        return lambda ticks, phase: seen.append((number, ticks))

    assert rig.hit("koul-compliant", watch, output=tmp_path, **SHORT).path.exists()
    assert {number for number, _ in seen} == {0}
    assert [ticks for _, ticks in seen] == sorted(ticks for _, ticks in seen)


def test_a_law_and_an_estimator_of_a_lab_run_and_are_recorded(own: rig.HitResult) -> None:
    inside = own.recording.rows["penetration"] > 0.0
    rows = own.recording.rows[inside & (own.recording.rows["phase"] == Phase.TRIAL)]
    expected = 100.0 * rows["penetration"] + 2e4 * rows["penetration"] ** 2 + 0.5 * rows["velocity"]
    assert rows["effort_wall"] == pytest.approx(expected, rel=1e-12)
    header = own.recording.header["initial_state"]
    assert (header["law"]["name"], header["estimator"]["name"]) == ("stiffening", "mine")
    assert header["law"]["parameters"] == [100.0, 0.5, 1 / 20_000, 2e4]


def test_a_hit_of_a_labs_law_replays_to_the_last_bit_with_its_recorded_parameters(own: rig.HitResult) -> None:
    for recording in (own.recording, own.path, str(own.path)):
        assert rig.replay(recording, law=stiffening(), estimator=blend()).exact
    other = rig.replay(own.path, law=stiffening(), estimator="fdm")
    assert (other.exact, other.estimator, other.law) == (False, "fdm", "stiffening")
    softer = rig.replay(own.path, law=stiffening(), estimator=blend(), stiffness=50.0)
    assert 0.0 < softer.effort_difference < np.inf
    walled = rig.replay(own.path, law="spring-damper", estimator=blend())
    assert (walled.law, walled.velocity_difference) == ("spring-damper", 0.0)
    with pytest.raises(ConfigError, match=r"unknown estimator 'mine'"):
        rig.replay(own.path, law=stiffening())
    with pytest.raises(RecordingError, match=r"nowhere.parquet"):
        rig.replay("nowhere.parquet")


def test_a_labs_law_is_known_by_its_name_only_while_it_runs(own: rig.HitResult) -> None:
    with pytest.raises(ConfigError, match=r'controller.estimator = "mine"'):
        rig.plan("koul-compliant", estimator="mine")
    planned = rig.plan("koul-compliant", estimator=blend(), law=stiffening())
    assert planned.ok
    assert "by mine" in repr(planned)


def test_a_labs_law_runs_in_every_thread_of_a_map(monkeypatch: pytest.MonkeyPatch) -> None:
    threads: set[int] = set()
    get = plugins.load

    def spied(*arguments: Any) -> Any:
        threads.add(threading.get_ident())
        return get(*arguments)

    monkeypatch.setattr(plugins, "load", spied)
    found = rig.zwidth(
        "koul-compliant", ["dual:20k/2k"], law=stiffening(), estimator=blend(), dampings=[0.0, 0.02],
        lowest=100.0, highest=120.0, search="bisection", ratio=1.1, offsets=[0.1], workers=2,
    )  # fmt: skip
    assert threading.get_ident() not in threads or len(threads) > 1
    assert found.plan.experiment.wall.law == "stiffening"
    assert found.plan.experiment.trial.kind == "human", "a preset is held by a hand, as the command has it"
    assert found.hits >= 2
    assert found.curve(0, "any")[1].stiffness >= found.curve(0, "any")[0].stiffness


def test_a_law_defined_in_this_program_goes_to_no_other_and_into_no_directory(tmp_path: Path) -> None:
    """A map that resumes or runs elsewhere finds a law by its name, and could find a different one."""
    with pytest.raises(ConfigError, match=r"mine is defined in this program only.*\"rig.estimators\""):
        rig.zwidth("koul-compliant", estimator=blend(), directory=tmp_path)
    with pytest.raises(ConfigError, match=r"stiffening is defined in this program only.*\"rig.laws\""):
        rig.zwidth("koul-compliant", law=stiffening(), scheduler="tcp://127.0.0.1:1")
    assert not list(tmp_path.iterdir())


def test_a_law_of_a_package_is_known_by_its_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "mylab", SimpleNamespace(soft=replace(stiffening(), name="soft")))
    point = EntryPoint("soft", "mylab:soft", "rig.laws")
    monkeypatch.setattr(plugins, "entry_points", lambda group: [point] if group == "rig.laws" else [])
    result = rig.hit("koul-compliant", law="soft", stiffness=200.0, output=tmp_path, **SHORT)
    assert rig.replay(result.recording).exact
    assert result.recording.header["initial_state"]["law"]["parameters"][0] == 200.0


def test_a_name_in_use_and_a_value_that_is_no_part_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"'fdm' is already the name of a built-in"):
        rig.plan("koul-compliant", estimator=replace(blend(), name="fdm"))
    with pytest.raises(ConfigError, match=r"'bilateral' is already the name of a built-in"):
        rig.hit("koul-compliant", law=replace(stiffening(), name="bilateral"))
    with pytest.raises(ConfigError, match=r"law is of type int; it must be a name.*@rig.law"):
        rig.hit(law=3)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"estimator is of type PlainLaw; it must be a name"):
        rig.plan(estimator=stiffening())  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "link", [{"url": "serial:///dev/ttyACM0"}, {"realtime": True}, {"round_trip_s": 0.0017}], ids=str
)
def test_a_plan_behind_a_link_is_judged_with_its_delay(link: dict[str, Any]) -> None:
    experiment = rig.load("koul-compliant")
    bare, planned = rig.plan(experiment), rig.plan(experiment, **link)
    assert (bare.ok, "delay" in {check.name for check in bare.checks}) == (True, False)
    assert not rig.plan(experiment, changes={"rig.limits.speed": 0.5}, **link).ok
    judged = delay_checks(config.with_realtime(experiment), link.get("round_trip_s"))
    assert [check for check in planned.checks if check in judged] == judged
