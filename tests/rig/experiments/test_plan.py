"""The plan of a hit: every check on both sides of its limit, and predictions that hits confirm.

The random rigs are a sample of `tests.benchmarks.plausible_rigs`; the others are bugs that it found.
"""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from firmware_protocol import messages as m
from firmware_protocol.framing import encode_frame
from firmware_protocol.packing import pack
from rig import config
from rig.analysis.theory import theory_of
from rig.config import Experiment, controller, presets, velocity_reading
from rig.config._load import experiment_from_mapping, with_realtime
from rig.config.velocity_reading import highest_reading
from rig.core.check import Check, Outcome
from rig.core.errors import PlanError
from rig.core.present import plain
from rig.core.sample import Phase
from rig.devices.device import LINK_SHARE, STATE_BYTES
from rig.doctor.late_loops import LateLoops
from rig.experiments.design._paths import fits_a_tick
from rig.experiments.trials.plan import delay_checks, link_checks, make_plan, plan_of, predict_impact
from sim_backend.bare import trial as bare
from sim_backend.mechanics.plant import DiscretePlant
from tests.benchmarks import plausible_rigs
from tests.benchmarks.plausible_rigs import named_changes, reaches
from tests.conformance.tiers import first_by_default
from tests.rig.config.test_homing import PHD

COMPLIANT, RIGID = presets.load("koul-compliant"), presets.load("koul-rigid")
SLOW = presets.load("moteus-knob")  # 1 kHz


def check(experiment: Any, name: Any) -> Any:
    return {check.name: check for check in make_plan(experiment).checks}[name]


def change(changes: Any, experiment: Any = COMPLIANT) -> Any:
    return config.override(experiment, changes)


def simulate_hit(experiment: Any) -> Any:
    """Simulate a hit without a link; return the largest speed before the wall and the depth of the first contact."""
    law = controller.for_experiment(experiment, current_quantum_a=experiment.rig.amplifier.current_quantum_a)
    plant = DiscretePlant.build(config.rig_model(experiment), 1.0 / experiment.controller.position_rate)
    trace = bare.run_trial(law, plant, 0.0, most_ticks=200_000)
    trial = np.flatnonzero(trace.phases == Phase.TRIAL)
    states = trace.states[trial]
    depth = experiment.wall.side * (states[:, plant.sensed_position] - experiment.wall.position)
    first = int(np.argmax(depth > 0.0))
    speed = np.abs(states[: first + 1, plant.sensed_position + 1]).max()
    # An undamped sampled wall throws the handle back harder each time.
    out = np.flatnonzero(depth[first:] <= 0.0)
    last = first + int(out[0]) if len(out) else len(depth)
    return speed, depth[first:last].max()


@pytest.mark.parametrize("name", presets.names())
@pytest.mark.parametrize("realtime", [False, True])
def test_the_prediction_errs_on_the_hard_side(name: Any, realtime: bool) -> None:
    """A real hit, damped by rig and wall, arrives more slowly and goes less deep than predicted."""
    experiment = presets.load(name)
    if realtime:
        experiment = config.with_realtime(experiment)
    impact = predict_impact(experiment)
    speed, depth = simulate_hit(experiment)
    assert speed <= 1.01 * impact.velocity
    assert depth <= 1.02 * impact.peak_penetration + experiment.rig.encoder.resolution
    assert speed > 0.3 * impact.velocity, "and it is no idle bound"


def test_the_prediction_in_closed_form() -> None:
    """Check v² = 2·F·d/m before the wall, and the depth x = F/K + √((F/K)² + m·v²/K)."""
    experiment = presets.load("chawda-linear")
    mass, push = 0.52, 8.0 - 0.19
    distance, stiffness = abs(experiment.trial.start), experiment.wall.stiffness
    assert experiment.trial.effort == 8.0
    impact = predict_impact(experiment)
    assert impact.velocity == pytest.approx(math.sqrt(2 * push * distance / mass))
    rest = 8.0 / stiffness
    deepest = rest + math.sqrt(rest**2 + mass * impact.velocity**2 / stiffness)
    assert impact.peak_penetration == pytest.approx(deepest)


def test_the_prediction_of_a_hand_includes_its_finger_pads() -> None:
    held = change({"trial.kind": "human", "operator.pads_mass": 0.04})
    impacts = [predict_impact(one) for one in (held, config.override(held, {"operator.pads_mass": 0.0}))]
    rest = config.push_at_rest(held) / held.wall.stiffness
    with_pads, without = ((one.peak_penetration - rest) ** 2 - rest**2 for one in impacts)
    mechanics = config.rig_model(held).mechanics
    pads = 0.04 * mechanics.handle_radius**2
    assert with_pads / without == pytest.approx(1.0 + pads / mechanics.inertia)
    assert impacts[0].velocity == impacts[1].velocity > 0.0


def test_a_push_from_the_other_side_is_predicted_alike() -> None:
    trial = COMPLIANT.trial
    mirrored = change({"wall.side": -1, "trial.effort": -trial.effort, "trial.start": -trial.start})
    assert predict_impact(mirrored) == predict_impact(COMPLIANT)
    assert [c.outcome for c in make_plan(mirrored).checks] == [c.outcome for c in make_plan(COMPLIANT).checks]


def test_friction_that_no_push_overcomes_means_no_impact() -> None:
    stuck = change({"rig.mechanics.motor_coulomb": 10.0})
    assert predict_impact(stuck).velocity == 0.0


def test_without_a_wall_the_handle_goes_anywhere() -> None:
    free = change({"wall.stiffness": 0.0})
    assert math.isinf(predict_impact(free).peak_penetration)
    plan = make_plan(free)
    assert not plan.ok
    assert check(free, "stiffness").outcome == Outcome.REFUSED
    json.dumps(plain(plan), allow_nan=False)


def test_impact_velocity_against_the_speed_limit() -> None:
    velocity = highest_reading(COMPLIANT, predict_impact(COMPLIANT).velocity)
    low, high = 0.99 * velocity, 1.01 * velocity
    assert check(change({"rig.limits.speed": high}), "impact velocity").outcome == Outcome.OK
    refused = check(change({"rig.limits.speed": low}), "impact velocity")
    assert (refused.outcome, bool(refused.remedy)) == (Outcome.REFUSED, True)


@pytest.mark.parametrize("side", [1, -1])
def test_peak_penetration_against_the_window(side: int) -> None:
    peak = predict_impact(COMPLIANT).peak_penetration
    low, high = 0.99 * peak, 1.01 * peak
    mirror = {"wall.side": side, "trial.effort": side * 0.15, "trial.start": -0.015 * side}
    edge = "rig.limits.position_maximum" if side > 0 else "rig.limits.position_minimum"
    assert check(change({**mirror, edge: side * high}), "peak penetration").outcome == Outcome.OK
    assert check(change({**mirror, edge: side * low}), "peak penetration").outcome == Outcome.REFUSED


def test_peak_effort_beyond_the_limit_is_a_warning() -> None:
    """A hit that saturates spoils its measurement but is not dangerous."""
    base = {"rig.limits.override_stall": True, "wall.stiffness": 200.0}
    peak = predict_impact(change(base)).peak_effort
    low, high = 0.99 * peak, 1.01 * peak
    assert check(change({**base, "rig.limits.effort": high}), "peak effort").outcome == Outcome.OK
    warned = change({**base, "rig.limits.effort": low})
    assert check(warned, "peak effort").outcome == Outcome.WARNING
    assert make_plan(warned).ok


def test_resting_penetration_against_the_least_counts() -> None:
    counts = COMPLIANT.trial.effort / COMPLIANT.wall.stiffness / COMPLIANT.rig.encoder.resolution
    low, high = 0.99 * counts, 1.01 * counts
    name = "resting penetration"
    assert check(change({"trial.minimum_rest_counts": low}), name).outcome == Outcome.OK
    # A file that asks for it is refused even earlier.
    asked = replace(COMPLIANT.trial, minimum_rest_counts=high)
    assert check(replace(COMPLIANT, trial=asked), name).outcome == Outcome.REFUSED
    assert check(change({"trial.effort": 0.03, "trial.minimum_rest_counts": 0}), name).outcome == Outcome.OK


def test_ripple_is_the_share_by_which_the_wall_varies() -> None:
    """At worst the crests of all harmonics coincide: 0.05 + 0.05 of 300 N·m/rad are 30."""
    zeros = {f"rig.cogging.{part}": [0.0, 0.0] for part in ("cosine", "sine")}
    ripples = {"rig.cogging.ripple_cosine": [0.03, 0.0], "rig.cogging.ripple_sine": [0.04, -0.05]}
    given = change({"rig.cogging.period": 0.6, "rig.cogging.orders": [1, 7], **zeros, **ripples})
    assert "K·(1 ± 0.1) over position, 270 to 330 N·m/rad" in check(given, "ripple").text
    assert "ripple" not in {one.name for one in make_plan(COMPLIANT).checks}


def test_motor_heat_over_all_repeats() -> None:
    """A time constant at load L uses L²·(1 − 1/e) of the budget; above nominal effort, long enough, all is used."""
    tau, nominal = COMPLIANT.rig.limits.thermal_time_constant_s, COMPLIANT.rig.limits.nominal_effort
    limits = {"rig.limits.effort": 2 * nominal, "rig.limits.override_stall": True}
    hot = {"trial.effort": 1.5 * nominal, "trial.duration_s": 1.0, **limits}
    limit_s = -tau * math.log1p(-1 / 1.5**2)
    few = change({**hot, "trial.repeats": max(1, math.floor(limit_s * 0.9))})
    assert check(few, "motor heat").outcome == Outcome.OK
    many = change({**hot, "trial.repeats": math.ceil(limit_s * 1.1)})
    assert check(many, "motor heat").outcome == Outcome.REFUSED
    assert check(change({"trial.repeats": 100_000}), "motor heat").outcome == Outcome.OK


def test_a_limit_that_does_not_fit_the_wire_is_a_plan_error() -> None:
    with pytest.raises(PlanError, match="speed_limit"):
        make_plan(change({"rig.limits.speed": 1e9}))


def test_the_duration_is_the_longest_that_it_may_take() -> None:
    x = change({"trial.repeats": 3})
    longest = x.homing.timeout_s + x.trial.duration_s + x.trial.release_s
    assert make_plan(x).duration_s == pytest.approx(3 * longest)


@pytest.mark.parametrize("name", presets.names())
def test_every_preset_has_a_plan_that_may_run_here_and_in_real_time(name: Any) -> None:
    for experiment in (presets.load(name), config.with_realtime(presets.load(name))):
        plan = make_plan(experiment)
        assert plan.ok, [c for c in plan.checks if c.outcome != Outcome.OK]


def test_a_rate_above_the_devices_is_refused_with_the_rate_to_choose() -> None:
    (ok,) = link_checks(change({"controller.position_rate": 4000}), 4000, None)
    assert ok.outcome == Outcome.OK
    (refused,) = link_checks(change({"controller.position_rate": 6000}), 4000, None)
    assert refused.outcome == Outcome.REFUSED
    assert "`rate` 4000" in refused.remedy


def test_no_frame_is_longer_than_the_plan_counts_with() -> None:
    for fill in (0, 1):
        assert len(encode_frame(pack(m.State(*[fill] * 16)))) == STATE_BYTES
        assert len(encode_frame(pack(m.Command(*[fill] * 5)))) <= STATE_BYTES


@pytest.mark.parametrize(
    ("baud", "rate", "outcome"),
    [
        (921_600, 1000, Outcome.OK),  # 52 kB/s of 64.5
        (921_600, 2000, Outcome.REFUSED),
        (460_800, 1000, Outcome.REFUSED),
        (115_200, 1000, Outcome.REFUSED),
        (115_200, 150, Outcome.OK),  # 7.8 kB/s of 8.1
    ],
)
def test_a_uart_carries_what_its_rate_allows(baud: int, rate: int, outcome: Any) -> None:
    capacity = baud / 10
    rates = {"controller.position_rate": rate, "controller.velocity_rate": rate}
    filters = {"controller.parameters.cutoff_hz": rate / 10, "verdict.lowpass_hz": rate / 3}
    experiment = change({**rates, **filters})
    checks = {c.name: c for c in link_checks(experiment, 50_000, capacity)}
    link = checks["link capacity"]
    assert link.outcome == outcome
    possible = int(LINK_SHARE * capacity / STATE_BYTES)
    assert (rate <= possible) is (outcome == Outcome.OK)
    assert f"`rate` {possible} or less" in link.remedy


def checks_by_name(experiment: Any, round_trip_s: float | None = None) -> dict[str, Any]:
    return {check.name: check for check in delay_checks(experiment, round_trip_s)}


@pytest.mark.parametrize(
    ("changes", "round_trip_s", "ticks", "why"),
    [
        ({}, None, 1, "assumed"),
        ({"rig.simulation.computation_delay_ticks": 3}, None, 3, "computation_delay_ticks"),
        ({"rig.simulation.computation_delay_ticks": 3}, 1.7e-3, 2, "as stated"),
        ({"host.pacing": "host"}, 1.7e-3, 3, "as stated"),
        ({"rig.amplifier.set_point_delay_s": 1.2e-3}, None, 3, "1 by the link"),
        ({"controller.loop": "device"}, 1.7e-3, 0, "the device runs the law"),
    ],
)
def test_a_plan_states_the_delay_that_counts_as_the_gate_counts_it(
    changes: dict[str, Any], round_trip_s: float | None, ticks: int, why: str
) -> None:
    found = checks_by_name(change(changes, SLOW), round_trip_s)["delay"].text
    assert found.startswith(f"{ticks} tick")
    assert f"{ticks * 1000} µs" in found
    assert why in found


def test_a_plan_warns_of_the_wall_that_the_gate_would_refuse_and_refuses_nothing() -> None:
    limit = min(LateLoops.of(SLOW, 2).k_max([0.0])[0].values())
    for factor, outcome in ((0.99, Outcome.OK), (1.01, Outcome.WARNING)):
        wall = change({"wall.stiffness": factor * limit, "wall.damping": 0.0}, SLOW)
        assert checks_by_name(wall, 1.5e-3)["stability"].outcome is outcome


@pytest.mark.parametrize("round_trip_s", [0.0, -1.0, math.nan, math.inf])
def test_an_impossible_round_trip_is_refused(round_trip_s: float) -> None:
    with pytest.raises(PlanError, match="round_trip"):
        delay_checks(SLOW, round_trip_s)


# ---------------------------------------------------------------------- hits match the predictions of their plans


# 6199: a phase margin of 1.5° in homing; 6316: two counts in which the push makes the handle fast.
@pytest.mark.parametrize("seed", first_by_default([6199, 6316, *range(8)], 2))
def test_a_random_rig_reaches_its_wall_as_planned_or_after_the_named_changes(seed: int) -> None:
    found = plausible_rigs.outcome(seed)
    assert found.reached, found


@pytest.mark.parametrize("rate", first_by_default([1_000, 4_000, 20_000]))
def test_a_first_own_rig_homes_without_any_key_of_homing(rate: int) -> None:
    x = experiment_from_mapping(PHD, "phd.toml")
    x = with_realtime(x) if rate == 1_000 else config.override(x, {"controller.position_rate": rate})
    assert make_plan(x).ok
    assert reaches(x, 0) == (True, "")


def test_a_preset_with_more_friction_homes_as_near_as_it_can() -> None:
    geared = {"rig.encoder.counts_per_revolution": 2048, "rig.encoder.ratio": 12.0}
    wall = {"wall.stiffness": 150.0, "wall.damping": 0.1}
    x = config.override(RIGID, {**geared, **wall, "rig.mechanics.motor_coulomb": 0.03})
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
    x = config.override(RIGID, rates | FINDINGS[name])
    found = {check.name: check for check in make_plan(x).checks if check.changes}
    assert name in found
    assert (found[name].outcome is Outcome.REFUSED) == (name != "approach")
    assert all(f"{key} = {value:g}" in found[name].remedy for key, value in found[name].changes.items())
    for _ in range(3):
        if not (again := [check for check in make_plan(x).checks if check.changes]):
            break
        x = config.override(x, named_changes(again))
    assert make_plan(x).ok
    assert reaches(x, 0)[0]


@pytest.mark.parametrize(
    ("lines", "name"), first_by_default([(85, "speed reading"), (90, "impact velocity")])
)
def test_a_reading_beyond_the_speed_limit_is_refused_with_a_cutoff(lines: int, name: str) -> None:
    encoder = {"rig.encoder.ratio": 1.0, "rig.encoder.counts_per_revolution": lines}
    homing = {"homing.stiffness": 2.0, "homing.damping": 0.06, "homing.tolerance_counts": 1.0}
    trial = {"trial.start": -0.2, "trial.duration_s": 1.5, "wall.stiffness": 1.0}
    x = config.override(RIGID, {**encoder, **homing, **trial})
    found = {check.name: check for check in make_plan(x).checks if check.outcome is Outcome.REFUSED}
    assert name in found
    assert "controller.parameters.cutoff_hz" in found[name].changes
    again = config.override(x, named_changes(tuple(found.values())))
    assert make_plan(again).ok
    assert reaches(again, 0) == (True, "")


def test_an_estimator_that_diverges_is_refused_without_a_change(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its velocity is infinite, then not a number. The remedy was `trial.effort = nan and wall.stiffness = nan`."""
    for name in ("_peak", "_pulse"):  # without their caches
        monkeypatch.setattr(velocity_reading, name, getattr(velocity_reading, name).__wrapped__)
    diverging = np.array([0.0, -math.inf, math.nan])
    monkeypatch.setattr(velocity_reading, "_estimate", lambda *_: np.append(np.zeros(5000), diverging))
    assert velocity_reading.quiet_cutoff(RIGID, 20.0) is None
    found = {one.name: one for one in make_plan(RIGID).checks}
    for name in ("impact velocity", "speed reading"):
        assert (found[name].outcome, found[name].changes) == (Outcome.REFUSED, {})
        assert "as up to inf rad/s" in found[name].text
        assert "choose another estimator" in found[name].remedy


def test_amplifier_steps_that_the_current_quantum_does_not_allow_are_named() -> None:
    changes = {"rig.amplifier.profile": "escon-50-5-pwm", "rig.amplifier.set_point_delay_s": 2.5e-4}
    x = config.override(RIGID, changes)
    (found,) = [check for check in make_plan(x).checks if check.name == "current monitor"]
    assert found.outcome is Outcome.WARNING
    again = config.override(x, named_changes((found,)))
    assert all(check.outcome is Outcome.OK for check in make_plan(again).checks if check.name == found.name)


def test_a_tick_that_a_board_has_no_time_for_is_named_with_rates_that_fit() -> None:
    x = config.override(RIGID, {"controller.loop": "device"})

    def tick(x: Experiment, board: str) -> Check:
        plan = plan_of(controller.prepare_controller(x), board=board)
        return next(one for one in plan.checks if one.name == "tick budget")

    slow, fast = (tick(x, board) for board in ("rp2040", "mps2"))
    assert (slow.outcome, fast.outcome) == (Outcome.WARNING, Outcome.OK)
    assert not fits_a_tick(x.controller, "rp2040")
    again = config.override(x, named_changes((slow,)))
    assert tick(again, "rp2040").outcome is Outcome.OK
    assert fits_a_tick(again.controller, "rp2040")
    assert not [c for c in make_plan(RIGID).checks if c.name == "tick budget"], "the computer runs the law"


def test_a_plan_states_the_cutoffs_that_a_comparison_of_its_rates_has() -> None:
    (found,) = [check for check in make_plan(RIGID).checks if check.name == "cut-offs compared"]
    assert found.text == theory_of(RIGID).cutoffs
    same = config.override(RIGID, {"controller.scheme_cutoff": "same"})
    assert not [check for check in make_plan(same).checks if check.name == found.name]
