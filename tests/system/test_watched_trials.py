"""Trials that end early at a limit of oscillations or energy, over a link and simulated directly; free space first."""

import re

import pytest

from rig.config import override, presets
from rig.control.verdict import Kind
from rig.core.errors import ConfigError, GuardError, PlanError
from rig.core.sample import Phase, RowFlag
from rig.experiments.hits.hit_simulator import HitSimulator
from rig.experiments.trials.plan import make_plan
from rig.experiments.trials.replay import replay
from rig.session.engine._baseline import baseline
from rig.testing import Hits, assert_stable
from tests.conformance.firmware import need_compiler

SHORT = {"trial.duration_s": 0.5, "trial.release_s": 0.02, "homing.settle_s": 0.02, "verdict.tail_s": 0.1}
HELD = {
    "trial.kind": "human",
    "rig.limits.human": False,  # the watch by itself, on walls stiffer than people may meet
    "operator.begin_s": 0.05,
    "operator.reach_s": 0.15,
}
PLACED = override(
    presets.load("koul-compliant"), {**SHORT, **HELD, "rig.simulation.initial_position": -0.015}
)
VIOLENT = {"wall.stiffness": 1200.0, "wall.damping": 0.5}


WATCHES = {
    "violent": ("oscillations", 10, RowFlag.VIOLENT, "oscillated 10 times in succession .* each within 0.02 s"),
    "energy": ("energy", 0.02, RowFlag.ENERGY, r"gave the handle 0\.0\d+ J, more than rig\.limits\.energy = 0\.02 J"),
}  # fmt: skip


@pytest.mark.parametrize("reason", WATCHES)
def test_a_violent_wall_is_ended_and_unstable_with_bytes_and_without(reason: str, rig_hit: Hits) -> None:
    name, value, flag, text = WATCHES[reason]
    experiment = override(PLACED, {**VIOLENT, f"rig.limits.{name}": value})
    simulator = HitSimulator(experiment)
    placed = override(experiment, {"rig.simulation.initial_position": simulator.start})
    hit, watched = rig_hit(placed, may_end=True), simulator.hit(1200.0, 0.5)
    rows, trailer = hit.recording.rows, hit.recording.trailer or {}
    assert trailer["reason"] == reason
    assert isinstance(hit.error, GuardError)
    assert re.search(text, str(hit.error))
    assert rows["flags"][-1] & flag
    assert not (rows["flags"][:-1] & (RowFlag.VIOLENT | RowFlag.ENERGY)).any()
    assert (rows["phase"][-1], rows["current_sent"][-1], rows["effort_sent"][-1]) == (Phase.DONE, 0, 0.0)
    assert trailer["watched"][name] > 0.0
    assert replay(hit.recording).exact
    assert hit.verdict.kind is watched.true.kind is Kind.UNSTABLE
    assert watched.ticks == len(rows), "without bytes it ends in the same tick"
    assert watched.true.thrown_out
    assert watched.true.passes("any") is False
    freely = HitSimulator(override(experiment, {f"rig.limits.{name}": None})).hit(1200.0, 0.5)
    assert freely.ticks > watched.ticks
    assert freely.true.kind is Kind.UNSTABLE
    assert not freely.true.thrown_out


def test_a_law_on_the_device_is_ended_by_the_host(rig_hit: Hits) -> None:
    need_compiler()
    experiment = override(
        presets.load("koul-rigid"),
        {**SHORT, **HELD, **VIOLENT, "wall.stiffness": 1100.0, "controller.loop": "device",
         "rig.limits.oscillations": 10, "rig.simulation.initial_position": -0.015},
    )  # fmt: skip
    hit = rig_hit(experiment, may_end=True)
    assert hit.recording.rows["flags"][-1] & RowFlag.VIOLENT
    assert "times in succession" in str(hit.error)


def test_the_push_of_a_motor_is_watched_where_that_is_set(rig_hit: Hits) -> None:
    motor = override(presets.load("koul-compliant"), {**SHORT, "wall.stiffness": 300.0})
    assert_stable(rig_hit(motor))
    with pytest.raises(PlanError, match=r"energy: the push gives up to"):
        rig_hit(motor, {"rig.limits.energy": 1e-3})
    watches = {"rig.limits.energy": 0.02, "rig.limits.oscillations": 10}
    assert {"energy", "violence"} <= {check.name for check in make_plan(override(motor, watches)).checks}
    assert_stable(rig_hit(motor, watches))


@pytest.mark.parametrize("grip", ["relaxed", "firm"])
def test_the_watch_changes_no_bit_of_a_stable_wall(grip: str) -> None:
    held = override(PLACED, {"operator.grip": grip, **HELD})
    freely = HitSimulator(held).hit(300.0, 0.5)
    watched = HitSimulator(override(held, {"rig.limits.oscillations": 10, "rig.limits.energy": 0.02})).hit(
        300.0, 0.5
    )
    assert freely.true.kind is Kind.STABLE
    assert freely.true.numbers.tobytes() == watched.true.numbers.tobytes()
    assert freely.ticks == watched.ticks


# ---------------------------------------------------------------------- free space


def test_a_baseline_comes_before_the_hit(rig_hit: Hits) -> None:
    plain = rig_hit(PLACED)
    result = rig_hit(PLACED, {"trial.baseline_s": 0.3, "rig.amplifier.current_noise_a": 0.002})
    assert result.verdict.contact_s == pytest.approx(plain.verdict.contact_s, abs=0.005)
    assert result.verdict.kind is plain.verdict.kind is Kind.STABLE
    assert result.verdict.ticks == plain.verdict.ticks
    found = baseline(result.recording, result.experiment)
    assert found is not None
    assert found.duration_s == pytest.approx(0.3)
    assert found.effort_rms == pytest.approx(0.002 * PLACED.rig.amplifier.effort_per_ampere, rel=0.1)
    assert found.sent_rms == 0.0
    assert found.count_range <= 2
    assert found.velocity_rms < 0.05
    assert baseline(plain.recording, plain.experiment) is None


def test_an_automated_trial_has_no_baseline() -> None:
    with pytest.raises(ConfigError, match=r"trial\.baseline_s .* must be 0 with trial\.kind"):
        override(presets.load("koul-compliant"), {"trial.baseline_s": 0.5})
    steps = [step.name for step in make_plan(override(PLACED, {"trial.baseline_s": 0.3})).steps]
    assert steps.index("wait") == steps.index("push") - 1
