"""Hits match the predictions of their plans: a sample of `tests.benchmarks.plausible_rigs`, and each bug it found."""

import math
from typing import Any

import numpy as np
import pytest

from rig.analysis.theory import theory_of
from rig.config import Experiment, controller, override, presets, velocity_reading
from rig.config._load import experiment_from_mapping, with_realtime
from rig.core.check import Check, Outcome
from rig.experiments.design._paths import fits_a_tick
from rig.experiments.trials.plan import make_plan, plan_of
from tests.benchmarks.plausible_rigs import named_changes, outcome, reaches
from tests.conformance.tiers import first_by_default
from tests.rig.config.test_homing import PHD

KOUL = presets.load("koul-rigid")


# 6199: a phase margin of 1.5° in homing; 6316: two counts in which the push makes the handle fast.
@pytest.mark.parametrize("seed", first_by_default([6199, 6316, *range(8)], 2))
def test_a_random_rig_reaches_its_wall_as_planned_or_after_the_named_changes(seed: int) -> None:
    found = outcome(seed)
    assert found.reached, found


@pytest.mark.parametrize("rate", first_by_default([1_000, 4_000, 20_000]))
def test_a_first_own_rig_homes_without_any_key_of_homing(rate: int) -> None:
    x = experiment_from_mapping(PHD, "phd.toml")
    x = with_realtime(x) if rate == 1_000 else override(x, {"controller.position_rate": rate})
    assert make_plan(x).ok
    assert reaches(x, 0) == (True, "")


def test_a_preset_with_more_friction_homes_as_near_as_it_can() -> None:
    geared = {"rig.encoder.counts_per_revolution": 2048, "rig.encoder.ratio": 12.0}
    wall = {"wall.stiffness": 150.0, "wall.damping": 0.1}
    x = override(KOUL, {**geared, **wall, "rig.mechanics.motor_coulomb": 0.03})
    assert make_plan(x).ok
    assert reaches(x, 0) == (True, "")


FINDINGS: dict[str, dict[str, Any]] = {
    "homing effort": {"homing.effort": 0.015},
    "homing stability": {"homing.stiffness": 4000.0, "homing.damping": 3.0},
    "homing slew": {"homing.slew": 3.0},
    "homing resolution": {"rig.encoder.counts_per_revolution": 20, "trial.minimum_rest_counts": 0.01},
    "homing offset": {"homing.stiffness": 1.5},
    "push": {"trial.effort": 0.022, "wall.stiffness": 20.0},
    "approach": {"trial.effort": 0.0253, "trial.start": -0.4, "verdict.tail_s": 0.9, "wall.stiffness": 20.0},
    "impact velocity": {"rig.limits.speed": 1.2},
    "peak penetration": {"rig.limits.position_maximum": 0.005, "wall.stiffness": 100.0},
}


@pytest.mark.parametrize("name", first_by_default(FINDINGS, 3))
def test_a_finding_names_values_with_which_the_plan_holds(name: str) -> None:
    rates = {"controller.position_rate": 2_000, "controller.velocity_rate": 2_000}
    x = override(KOUL, rates | FINDINGS[name])
    found = {check.name: check for check in make_plan(x).checks if check.changes}
    assert name in found
    assert (found[name].outcome is Outcome.REFUSED) == (name != "approach")
    assert all(f"{key} = {value:g}" in found[name].remedy for key, value in found[name].changes.items())
    for _ in range(3):
        if not (again := [check for check in make_plan(x).checks if check.changes]):
            break
        x = override(x, named_changes(again))
    assert make_plan(x).ok
    assert reaches(x, 0)[0]


@pytest.mark.parametrize(
    ("lines", "name"), first_by_default([(85, "speed reading"), (90, "impact velocity")])
)
def test_a_reading_beyond_the_speed_limit_is_refused_with_a_cutoff(lines: int, name: str) -> None:
    encoder = {"rig.encoder.ratio": 1.0, "rig.encoder.counts_per_revolution": lines}
    homing = {"homing.stiffness": 2.0, "homing.damping": 0.06, "homing.tolerance_counts": 1.0}
    trial = {"trial.start": -0.2, "trial.duration_s": 1.5, "wall.stiffness": 1.0}
    x = override(KOUL, {**encoder, **homing, **trial})
    found = {check.name: check for check in make_plan(x).checks if check.outcome is Outcome.REFUSED}
    assert name in found
    assert "controller.parameters.cutoff_hz" in found[name].changes
    again = override(x, named_changes(tuple(found.values())))
    assert make_plan(again).ok
    assert reaches(again, 0) == (True, "")


def test_an_estimator_that_diverges_is_refused_without_a_change(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its velocity is infinite, then not a number. The remedy was `trial.effort = nan and wall.stiffness = nan`."""
    for name in ("_peak", "_pulse"):  # without their caches
        monkeypatch.setattr(velocity_reading, name, getattr(velocity_reading, name).__wrapped__)
    diverging = np.array([0.0, -math.inf, math.nan])
    monkeypatch.setattr(velocity_reading, "_estimate", lambda *_: np.append(np.zeros(5000), diverging))
    assert velocity_reading.quiet_cutoff(KOUL, 20.0) is None
    found = {one.name: one for one in make_plan(KOUL).checks}
    for name in ("impact velocity", "speed reading"):
        assert (found[name].outcome, found[name].changes) == (Outcome.REFUSED, {})
        assert "as up to inf rad/s" in found[name].text
        assert "choose another estimator" in found[name].remedy


def test_amplifier_steps_that_the_current_quantum_does_not_allow_are_named() -> None:
    changes = {"rig.amplifier.profile": "escon-50-5-pwm", "rig.amplifier.set_point_delay_s": 2.5e-4}
    x = override(KOUL, changes)
    (found,) = [check for check in make_plan(x).checks if check.name == "current monitor"]
    assert found.outcome is Outcome.WARNING
    again = override(x, named_changes((found,)))
    assert all(check.outcome is Outcome.OK for check in make_plan(again).checks if check.name == found.name)


def test_a_tick_that_a_board_has_no_time_for_is_named_with_rates_that_fit() -> None:
    x = override(KOUL, {"controller.loop": "device"})

    def tick(x: Experiment, board: str) -> Check:
        plan = plan_of(controller.prepare_controller(x), board=board)
        return next(one for one in plan.checks if one.name == "tick budget")

    slow, fast = (tick(x, board) for board in ("rp2040", "mps2"))
    assert (slow.outcome, fast.outcome) == (Outcome.WARNING, Outcome.OK)
    assert not fits_a_tick(x.controller, "rp2040")
    again = override(x, named_changes((slow,)))
    assert tick(again, "rp2040").outcome is Outcome.OK
    assert fits_a_tick(again.controller, "rp2040")
    assert not [c for c in make_plan(KOUL).checks if c.name == "tick budget"], "the computer runs the law"


def test_a_plan_states_the_cutoffs_that_a_comparison_of_its_rates_has() -> None:
    (found,) = [check for check in make_plan(KOUL).checks if check.name == "cut-offs compared"]
    assert found.text == theory_of(KOUL).cutoffs
    same = override(KOUL, {"controller.scheme_cutoff": "same"})
    assert not [check for check in make_plan(same).checks if check.name == found.name]
