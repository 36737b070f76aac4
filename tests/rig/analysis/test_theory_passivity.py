"""Conditions for passivity: published tables, brute force where no closed form exists, and where conditions fail."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig import config
from rig.analysis import theory
from rig.analysis.theory._passivity import estimator_delay_s
from rig.config import presets

KOUL = config.rig_model(presets.load("koul-compliant"))
RIGID = config.rig_model(presets.load("koul-rigid"))
VOLTAGE = replace(RIGID, amplifier=replace(RIGID.amplifier, drive="voltage"))
IDEAL = replace(RIGID, amplifier=replace(RIGID.amplifier, lag_s=0.0))


def beta(scheme: Any, **options: Any) -> Any:
    return theory.beta(theory.linear_loop(IDEAL, scheme), **options)


@pytest.mark.parametrize(("share", "table"), [(20, 0.354), (10, 0.479), (5, 0.675)])
@pytest.mark.parametrize("rates", ["dual:20k/2k", "uniform:1k"])
def test_beta_of_butterworth_depends_on_the_share_of_the_rate(share: int, table: float, rates: str) -> None:
    rate = theory.linear_loop(IDEAL, rates).controller.velocity_rate
    assert beta(f"{rates},cutoff_hz={rate / share}") == pytest.approx(table, abs=5e-4)
    assert beta(f"{rates},cutoff_hz={rate / share}", negative=True) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("rates", ["dual:20k/2k", "uniform:20k"])
def test_beta_of_a_bare_difference_is_one(rates: str) -> None:
    assert beta(f"{rates},estimator=fdm") == pytest.approx(1.0, abs=1e-9)
    assert beta("uniform:1k,cutoff_hz=499") == pytest.approx(1.0, abs=1e-3)


def test_on_two_masses_the_damper_behind_the_capstan_counts_in_series() -> None:
    """Search the least Re Z at the motor over all frequencies and passive hands; a sum would be too large."""
    mechanics = replace(KOUL.mechanics, link_damping=0.03, end_mass=0.0)
    subject = theory.resolve(replace(KOUL, mechanics=mechanics))
    k, c, link = mechanics.transmission_stiffness, mechanics.transmission_damping, 0.03
    s = 2j * math.pi * np.geomspace(1.0, 1e5, 200)[:, None]
    reactances = np.concatenate([-np.geomspace(1e-6, 1e3, 1500), np.geomspace(1e-6, 1e3, 1500)])
    series = 1.0 / (s / (k + c * s) + 1.0 / (link + 1j * reactances))
    least = float(series.real.min())
    assert subject.port_damping == pytest.approx(mechanics.motor_damping + least, rel=1e-3)
    assert subject.port_damping < subject.damping


def test_dual_rate_relaxes_the_bound_on_k_n_fold_and_leaves_that_on_b() -> None:
    dual = theory.passivity_bound(IDEAL, "dual:20k/2k,cutoff_hz=200")
    uniform = theory.passivity_bound(IDEAL, "uniform:2k,cutoff_hz=200")
    assert dual.stiffness == pytest.approx(10 * uniform.stiffness, rel=1e-9)
    assert dual.largest_damping == pytest.approx(uniform.largest_damping, rel=1e-9)


def test_lag_and_delay_tighten_the_bound() -> None:
    late = replace(RIGID, simulation=replace(RIGID.simulation, computation_delay_ticks=2))
    found = theory.passivity_bound(late, "dual:20k/2k", 1e-3)
    needed = 3e-3 - found.beta * 1e-3
    exact, line, ideal = found.bounds[:3]
    assert line.stiffness == pytest.approx(needed / (0.25e-4 + 1.09e-4 + 1e-4), rel=1e-9)
    assert ideal.stiffness == pytest.approx(needed / 0.25e-4, rel=1e-9)
    assert exact.name == "passivity, lag and delay counted"
    assert found.binding is exact
    assert 0.9 * line.stiffness < found.stiffness == exact.stiffness < 1.1 * line.stiffness
    assert found.largest_damping < 3e-3 / found.beta


def test_a_slow_pulse_width_costs_most_of_the_stiffness() -> None:
    """b = 3 mN·m·s/rad over half a tick (25 µs), lag (109 µs) and delay (250 µs, the period at 4 kHz)."""
    slow = replace(RIGID, amplifier=replace(RIGID.amplifier, set_point_delay_s=2.5e-4))
    at_once, late = (theory.passivity_bound(rig, "dual:20k/2k", 0.0).stiffness for rig in (RIGID, slow))
    assert at_once == pytest.approx(3e-3 / 134e-6, rel=0.02)
    assert late == pytest.approx(3e-3 / 384e-6, rel=0.02)


def test_one_damping_of_the_rig_stands_in_all_of_a_bound() -> None:
    """On two masses it is the damping at the motor; only slow motion, at B = 0, meets all damping."""
    heavy = replace(KOUL, mechanics=replace(KOUL.mechanics, link_damping=0.5))
    subject = theory.resolve(heavy)
    assert subject.port_damping < 0.9 * subject.damping
    for damping, b in ((0.0, subject.damping), (1e-3, subject.port_damping)):
        found = theory.passivity_bound(heavy, "dual:20k/2k", damping)
        _, line, ideal, *_ = found.bounds
        assert found.rig_damping == subject.port_damping
        assert ideal.stiffness == pytest.approx((b - found.beta * damping) / 0.25e-4)
        late_s = theory.linear_loop(heavy, "uniform:20k").late_s
        assert line.stiffness == pytest.approx((b - found.beta * damping) / (0.25e-4 + late_s))
    prompt = replace(heavy, amplifier=replace(heavy.amplifier, lag_s=0.0))
    found = {b.name: b for b in theory.passivity_bound(prompt, "uniform:20k").bounds}
    assert found["Colgate and Schenkel"].stiffness == pytest.approx(subject.port_damping / 0.25e-4)
    assert found["Abbott and Okamura"].stiffness <= subject.port_damping / 0.25e-4
    assert found["Abbott and Okamura"].meaning == "approximate"


def test_gils_rule_is_given_where_it_means_something() -> None:
    """It needs B = 0: at B·τ/J = 0.1, τ the estimator's delay, it is already twice too high."""
    rule = {b.name: b.stiffness for b in theory.passivity_bound(RIGID, "dual:20k/2k").bounds}["Gil"]
    assert theory.k_max(RIGID, "dual:20k/2k").stiffness == pytest.approx(rule, rel=0.01)
    loop = theory.linear_loop(RIGID, "dual:20k/2k")
    damping = 0.1 * loop.subject.inertia / estimator_delay_s(loop)
    rule = (loop.subject.damping + damping) / (0.5 * loop.tick_s + loop.late_s)
    assert theory.k_max(RIGID, "dual:20k/2k", damping).stiffness < 0.55 * rule
    assert "Gil" not in {b.name for b in theory.passivity_bound(RIGID, "dual:20k/2k", damping).bounds}


def test_back_emf_is_damping_under_voltage_drive_only() -> None:
    assert theory.resolve(RIGID).damping == pytest.approx(3e-3)
    assert theory.resolve(VOLTAGE).damping == pytest.approx(3e-3 + 0.0253)


def test_no_closed_form_is_given_where_back_emf_is_damping_of_slow_motion_only() -> None:
    """At B = 0 slow motion decides, and Gil's rule is K_max; without lag, back-EMF damps any motion."""
    damped = theory.passivity_bound(VOLTAGE, "uniform:20k", 0.02)
    (exact,) = damped.bounds
    assert exact.meaning == "exact"
    slow = (0.0283 - damped.beta * 0.02) / (0.25e-4 + 1.09e-4)
    assert 0.0 < exact.stiffness < 0.5 * slow, "the closed form, with the damping of slow motion"
    undamped = {b.name: b for b in theory.passivity_bound(VOLTAGE, "uniform:20k").bounds}
    line = undamped["Colgate and Schenkel, lag and delay"]
    assert line.meaning == "necessary"
    assert line.stiffness == pytest.approx(0.0283 / (0.25e-4 + 1.09e-4))
    assert 0.97 * line.stiffness < undamped["passivity, lag and delay counted"].stiffness < line.stiffness
    rule = undamped["Gil"].stiffness
    assert theory.k_max(VOLTAGE, "uniform:20k").stiffness == pytest.approx(rule, rel=1e-3)
    prompt = replace(VOLTAGE, amplifier=replace(VOLTAGE.amplifier, lag_s=0.0))
    found = theory.passivity_bound(prompt, "uniform:20k", 0.02).bounds[0]
    assert (found.name, found.meaning) == ("Colgate and Schenkel", "exact")
    assert found.stiffness == pytest.approx((0.0283 - damped.beta * 0.02) / 0.25e-4)


@settings(max_examples=6)
@given(
    log_inertia=st.floats(-5.0, -2.0),
    log_damping=st.floats(-4.0, -1.5),
    log_back_emf=st.floats(-4.0, -0.5),
    log_lag=st.floats(-5.0, -3.0),
    scheme=st.sampled_from(["dual:20k/2k,cutoff_hz=200", "uniform:20k"]),
)
def test_no_rule_under_voltage_drive_is_unsafe(
    log_inertia: float, log_damping: float, log_back_emf: float, log_lag: float, scheme: str
) -> None:
    motor = {"motor_inertia": 10**log_inertia, "motor_damping": 10**log_damping}
    mechanics = replace(RIGID.mechanics, **motor, link_damping=0.0, end_mass=0.0)
    amplifier = replace(VOLTAGE.amplifier, back_emf_damping=10**log_back_emf, lag_s=10**log_lag)
    rig = replace(VOLTAGE, mechanics=mechanics, amplifier=amplifier)
    assert theory.rigid_b_max(theory.linear_loop(rig, scheme)) < theory.b_max(rig, scheme).damping
    exact, *others = theory.passivity_bound(rig, scheme).bounds
    necessary = [b.stiffness for b in others if b.meaning == "necessary"]
    assert exact.stiffness <= min(necessary) * (1.0 + 1e-9)


def test_each_bound_says_formula_source_and_meaning() -> None:
    bounds = {b.name: b for b in theory.passivity_bound("chawda-linear", "uniform:1k").bounds}
    assert bounds["Colgate and Schenkel"].meaning == "exact"
    assert bounds["Colgate and Schenkel"].stiffness == pytest.approx(26.4e3, rel=1e-9)
    assert bounds["Abbott and Okamura"].stiffness == pytest.approx(min(26.4e3, 2 * 0.19 / 1e-6), rel=1e-9)
    assert bounds["Gil"].meaning == "approximate"
    assert all(b.formula and b.source for b in bounds.values())
    assert bounds["Abbott and Okamura"].meaning == "sufficient"
    prompt = replace(KOUL, amplifier=replace(KOUL.amplifier, lag_s=0.0))
    firsts = [theory.passivity_bound(rig, "dual:20k/2k").bounds[0] for rig in (IDEAL, prompt)]
    assert [first.meaning for first in firsts] == ["exact", "sufficient"], (
        "of two masses a bound is sufficient"
    )
    damped = {b.name: b.stiffness for b in theory.passivity_bound("chawda-linear", "uniform:1k", 20.0).bounds}
    assert "Gil" not in damped
    assert "Abbott and Okamura" not in damped


def test_friction_binds_where_the_quantum_is_coarse() -> None:
    """With Koul's encoder at ×1 decoding, 2 f_c/Δ falls below 2b/T."""
    coarse = replace(KOUL, encoder=replace(KOUL.encoder, decoding=1))
    found = {b.name: b.stiffness for b in theory.passivity_bound(coarse, "uniform:20k").bounds}
    assert found["Abbott and Okamura"] == pytest.approx(2 * 0.0067 / (2 * math.pi / 10_000), rel=1e-9)


@pytest.mark.parametrize(
    ("stiffness", "damping", "coulomb", "region"),
    [
        (10.0, 3e-3, 0.02, "no limit cycle"),
        (10.0, 3e-3, 1e-6, "bounded limit cycle of the quantiser"),
        (100.0, 1e-3, 0.02, "locally stable, unstable for large motion"),
        (100.0, 1e-3, 1e-6, "unstable"),
    ],
)
def test_diolaitis_plane_has_regions(stiffness: float, damping: float, coulomb: float, region: str) -> None:
    mechanics = replace(RIGID.mechanics, motor_damping=damping, link_damping=0.0, motor_coulomb=coulomb)
    found = theory.diolaiti(replace(RIGID, mechanics=mechanics), "uniform:20k", stiffness)
    assert found.region == region
    assert found.damping == pytest.approx(damping / (stiffness * 2 * (0.25e-4 + 1.09e-4)))
    assert found.friction == pytest.approx(coulomb / (stiffness * RIGID.encoder.resolution))


@pytest.mark.parametrize(
    ("scheme", "within"),
    [("dual:20k/2k,cutoff_hz=200", 0.05), ("uniform:2k,cutoff_hz=200", 0.05), ("uniform:20k", 0.21)],
)
def test_rule_for_the_largest_damping_is_near_and_safe(scheme: str, within: float) -> None:
    rule, exact = theory.rigid_b_max(theory.linear_loop(RIGID, scheme)), theory.b_max(RIGID, scheme).damping
    assert (1 - within) * exact < rule < exact
