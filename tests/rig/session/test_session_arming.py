"""Walls of a study that the arming check rejects: named before a person touches the handle, consent asked once."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from rig import config, devices
from rig.config import Experiment
from rig.config.presets import load as preset
from rig.core.check import Outcome
from rig.core.errors import ConfigError, PlanError
from rig.doctor import gate as gates
from rig.doctor.gate import gate, refused_among
from rig.experiments.hits.hit import HitRequest
from rig.session.engine import _hits as hits
from rig.session.engine._arming import arming_checks, refuse_unarmable, walls_of
from rig.session.engine._check import check
from rig.session.engine._desk import Desk, Reply
from rig.session.engine._device_checks import device_checks
from rig.session.engine._directory import LOG
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import read
from rig.session.engine._rehearsal import Person
from rig.session.engine._run import resume_session, run_session
from rig.session.engine._runner import RefusedWalls, SessionWall
from rig.session.engine._telling import line_of_event, whole_line
from rig.session.planning._conditions import Walls
from rig.session.planning._schedule import levels_of
from rig.session.terminal._seat import refuse_a_hand
from tests.conformance.made_links import link
from tests.conformance.tiers import first_by_default
from tests.rig.session.session_fakes import SHORT_SEARCH, FakeRunner, ScriptedDesk, protocol_of, study
from tests.system.session_study import PROTOCOL

KOUL = preset("koul-rigid")


class RealRunner(FakeRunner):
    """A rig that moves, whose arming check rejects the stiffest walls of each search, from its third on."""

    simulated = False

    def __init__(self, *, arm_anyway: bool = False) -> None:
        super().__init__()
        self.arm_anyway = arm_anyway
        self.asked: list[SessionWall] = []

    def refusals(self, walls: Sequence[SessionWall]) -> Sequence[RefusedWalls]:
        self.asked += walls
        by_search: dict[tuple[str, float], list[float]] = {}
        for wall in walls:
            x = wall.experiment
            by_search.setdefault((wall.condition, x.wall.damping), []).append(x.wall.stiffness)
        return [
            RefusedWalls(
                condition=name, damping=b, stiffness=tuple(found[2:]), walls=len(found), text="it oscillates"
            )
            for (name, b), found in by_search.items()
        ]

    def hit(self, experiment: Experiment, *more: Any) -> Any:
        if not self.arm_anyway and experiment.wall.stiffness >= levels_of(protocol_of().search)[2]:
            raise PlanError("this wall must not be armed")
        return super().hit(experiment, *more)


def written(directory: Path, blind: str = "both") -> Path:
    path = directory / "quick.toml"
    path.write_text(PROTOCOL.replace("seed = 11", f'seed = 11\nblind = "{blind}"', 1))
    return path


def at(desk: ScriptedDesk) -> Callable[..., Desk]:
    return lambda protocol, experiment, runner: desk


def test_a_study_whose_walls_are_refused_does_not_begin(tmp_path: Path) -> None:
    runner, desk = RealRunner(), ScriptedDesk()
    with pytest.raises(PlanError) as refused:
        run_session(written(tmp_path, "none"), "P01", at(desk), runner=runner, study=tmp_path / "study")
    assert "`arm_anyway`" in str(refused.value)
    assert "hidden-dual, B = 0.211: 4 of 6 walls, from K = 60 to 120" in str(refused.value)
    assert "it oscillates" in str(refused.value)
    assert (runner.hits, desk.questions) == ([], [])
    assert not (tmp_path / "study").exists()


def test_a_blinded_operator_sees_how_many_walls_are_refused_and_none_of_them(tmp_path: Path) -> None:
    with pytest.raises(PlanError) as refused:
        run_session(
            written(tmp_path), "P01", at(ScriptedDesk()), runner=RealRunner(), study=tmp_path / "study"
        )
    text = str(refused.value)
    assert "8 walls of 2 searches" in text
    assert not any(word in text for word in ("hidden", "0.211", "60", "120"))


def test_no_simulated_person_and_no_simulated_hand_uses_a_real_rig(tmp_path: Path) -> None:
    runner = RealRunner(arm_anyway=True)
    run = partial(run_session, written(tmp_path), "P01", at(ScriptedDesk()), study=tmp_path / "study")
    with pytest.raises(ConfigError, match="a rehearsal cannot use a real rig"):
        run(runner=runner, person=Person(thresholds={}))
    with pytest.raises(ConfigError, match="needs a simulated rig"):
        refuse_a_hand("keyboard", runner)
    assert runner.hits == []
    assert not (tmp_path / "study").exists()


def test_a_session_is_resumed_with_consent_too_or_not_at_all(tmp_path: Path) -> None:
    leaves = ScriptedDesk(lambda question: Reply(action="abort") if question.kind == "verdict" else None)
    runner = RealRunner(arm_anyway=True)
    run_session(written(tmp_path), "P01", at(leaves), runner=runner, study=tmp_path)
    before = (tmp_path / "P01" / LOG).read_bytes()
    with pytest.raises(PlanError, match="refuses"):
        resume_session(tmp_path / "P01", at(ScriptedDesk()), runner=RealRunner())
    assert (tmp_path / "P01" / LOG).read_bytes() == before
    again = resume_session(tmp_path / "P01", at(ScriptedDesk()), runner=RealRunner(arm_anyway=True))
    assert again.ended == "complete"


def test_every_wall_that_a_session_may_ask_for_is_asked_about(tmp_path: Path) -> None:
    protocol = protocol_of(practice={"stiffness": [130.0, 210.0]})
    walls = list(walls_of(Walls(protocol, KOUL)))
    found = {(wall.condition, wall.experiment.wall.stiffness) for wall in walls}
    levels = levels_of(protocol.search)
    expected = {(name, level) for name in ("dual-hidden", "uniform-hidden") for level in levels}
    assert found == expected | {("dual-hidden", 130.0), ("dual-hidden", 210.0)}
    assert {wall.experiment.wall.damping for wall in walls} == {0.37}
    dual = next(wall for wall in walls if wall.condition == "dual-hidden")
    assert dual.changes == {"controller.position_rate": 20_000, "controller.velocity_rate": 2_000}


def test_a_simulated_rig_is_never_refused() -> None:
    runner = RealRunner()
    runner.simulated = True
    refuse_unarmable(Walls(protocol_of(), KOUL), runner)
    assert list(arming_checks(Walls(protocol_of(), KOUL), runner)) == []
    assert runner.asked == []


def test_the_plan_of_a_study_lists_what_needs_consent() -> None:
    (found,) = arming_checks(Walls(protocol_of(), KOUL), RealRunner())
    assert found.outcome is Outcome.WARNING
    assert "dual-hidden, B = 0.37: 19 of 21 walls, from K = 150 to 600 N·m/rad" in found.text
    assert "`arm_anyway`" in found.remedy


# ------------------------------------------------------------------- a device, and a link as it was measured


@pytest.mark.parametrize("travel_s", first_by_default([30e-6, 120e-6, 0.4]))
@pytest.mark.parametrize("scheme", first_by_default([1, 0]))
def test_the_quick_answer_is_that_of_the_gate(scheme: int, travel_s: float) -> None:
    protocol = protocol_of()
    name = protocol.condition[scheme].name
    walls = [wall.experiment for wall in walls_of(Walls(protocol, KOUL)) if wall.condition == name][::5]
    expected = [x.wall.stiffness for x in walls if not gate(x, link(travel_s)).armable]
    assert refused_among(walls[0], link(travel_s), [x.wall.stiffness for x in walls]) == tuple(expected)


@pytest.fixture
def real_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a simulated device claim to be real, on a link that takes 30 µs each way."""
    open_simulated = devices.open_device

    def open_device(url: str, model: Any = None) -> Any:
        device = open_simulated("sim://", config.rig_model(KOUL))
        device._dictionary = replace(device.dictionary, simulated=False)
        device.link.clock.virtual = False  # it claims that, too: nothing is run on it
        return device

    monkeypatch.setattr(devices, "open_device", open_device)
    monkeypatch.setattr(gates, "measured_once", lambda *arguments: link(30e-6))


def test_a_real_rig_says_what_the_gate_would_say_of_each_wall(real_device: None) -> None:
    protocol = protocol_of(study=study(changes={**study()["changes"], "verdict.lowpass_hz": 400.0}))
    runner = DeviceRunner(url="serial:///dev/rig", verified=True)
    walls = tuple(walls_of(Walls(protocol, KOUL)))
    found = runner.refusals(walls)
    dual = next(one for one in found if one.condition == "dual-hidden")
    assert dual.walls == 21
    assert dual.stiffness[0] == 100.0  # in a relaxed hand none of them holds
    assert "unstable at 20000 Hz" in dual.text
    facts = runner.facts(walls[0].experiment, walls[0].changes)
    assert facts["armed_anyway"][0]["stiffness"][0] == 100.0
    runner.close()


def test_a_rig_of_unverified_polarity_is_refused_before_anything_else(real_device: None) -> None:
    with pytest.raises(ConfigError, match="is not verified"):
        DeviceRunner(url="serial:///dev/rig").refusals(tuple(walls_of(Walls(protocol_of(), KOUL))))


def test_the_check_of_a_study_asks_the_device(real_device: None, tmp_path: Path) -> None:
    plan = check(
        protocol_of(search=SHORT_SEARCH), tmp_path, of_device=partial(device_checks, "serial:///dev/rig")
    )
    (found,) = (one for one in plan.checks if one.name == "arming")
    assert found.outcome is Outcome.WARNING
    assert "dual-hidden" in found.text


@pytest.mark.parametrize("consent", [False, True])
def test_consent_reaches_every_hit(consent: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def hit(request: HitRequest, admit: Any, watch: Any) -> Any:
        asked.append(request.arm_anyway)
        raise PlanError("enough")

    monkeypatch.setattr(hits, "hit", hit)
    monkeypatch.setattr(DeviceRunner, "_device", lambda *arguments: None)
    runner = DeviceRunner(url="serial:///dev/rig", arm_anyway=consent)
    wall = next(walls_of(Walls(protocol_of(), KOUL)))
    with pytest.raises(PlanError, match="enough"):
        runner.hit(wall.experiment, wall.changes, tmp_path, "t0001", lambda x: None, 0.0)
    assert asked == [consent]


def test_the_log_says_what_is_armed_all_the_same(tmp_path: Path) -> None:
    runner = RealRunner(arm_anyway=True)
    armed = [{"condition": "a", "damping": 0.1, "stiffness": [60.0, 80.0]}]
    facts = {**runner.facts(KOUL, {}), "armed_anyway": armed}
    runner.facts = lambda *arguments: facts  # type: ignore[method-assign]
    run_session(written(tmp_path), "P01", at(ScriptedDesk()), runner=runner, study=tmp_path)
    opened = next(event for event in read(tmp_path / "P01" / LOG) if event.kind == "opened")
    assert opened.content["armed_anyway"] == armed
    assert "2 walls that the arming gate refuses" in line_of_event(opened)
    assert "60" not in line_of_event(opened)
    assert whole_line(opened, "rotary").endswith("; armed anyway: a, B = 0.1, K = 60, 80")
