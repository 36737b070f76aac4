"""The lifted loop against simulations written out here, closed forms, and characteristic polynomials."""

import cmath
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, cont2discrete, place_poles, ss2tf

from rig import config
from rig.analysis import theory
from rig.config import presets
from rig.core.errors import ConfigError
from rig.core.operators import GRIPS
from tests.conformance.tiers import first_by_default

KOUL = config.rig_model(presets.load("koul-compliant"))
RIGID = config.rig_model(presets.load("koul-rigid"))


def with_delay(model: Any, ticks: Any) -> Any:
    return replace(model, simulation=replace(model.simulation, computation_delay_ticks=ticks))


def without_lag(model: Any) -> Any:
    return replace(model, amplifier=replace(model.amplifier, lag_s=0.0))


def plant(model: Any, hand: Any = None) -> Any:
    """Return continuous matrices for a command, derived again here; the first state is the sensed position."""
    m, lag = model.mechanics, model.amplifier.lag_s
    radius = m.handle_radius
    link = m.link_inertia + (m.end_mass if hand is None else hand.pads_mass) * radius**2
    masses = [m.motor_inertia, link] + ([] if hand is None else [hand.hand_mass * radius**2])
    dampers = [m.motor_damping, m.link_damping] + ([] if hand is None else [hand.hand_damping * radius**2])
    springs = [0.0, 0.0] + ([] if hand is None else [hand.hand_stiffness * radius**2])
    joints = [(0, 1, m.transmission_stiffness, m.transmission_damping)]
    if hand is not None:
        joints.append((1, 2, hand.pads_stiffness * radius**2, hand.pads_damping * radius**2))
    if m.structure == "rigid":
        assert hand is None
        masses, dampers, springs, joints = [sum(masses)], [sum(dampers)], [0.0], []
    n = len(masses)
    stiffness, damping = np.diag(springs), np.diag(dampers)
    for i, j, k, c in joints:
        pair = np.zeros(n)
        pair[i], pair[j] = 1.0, -1.0
        stiffness, damping = stiffness + k * np.outer(pair, pair), damping + c * np.outer(pair, pair)
    inverse = np.diag(1.0 / np.array(masses))
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
    b = np.zeros((2 * n, 1))
    b[n] = 1.0 / masses[0]
    if lag > 0.0:
        a = np.block([[a, b], [np.zeros((1, 2 * n)), np.array([[-1.0 / lag]])]])
        b = np.zeros((2 * n + 1, 1))
        b[-1] = 1.0 / lag
    return a, b


def envelopes(
    model: Any, k: Any, b: Any, *, rates: Any, cutoff_hz: Any, seconds: Any, hand: Any = None,
    extrapolate: bool = False, observer: Any = None,
) -> Any:  # fmt: skip
    """Step walls k, b tick by tick; return weighted rms of position and effort in two windows at the end."""
    fast, slow = rates
    every = fast // slow
    a, into = plant(model, hand)
    order = len(a)
    phi, gamma = cont2discrete((a, into, np.eye(order), np.zeros((order, 1))), 1.0 / fast)[:2]
    ((b0, b1, b2, _, a1, a2),) = butter(2, cutoff_hz, fs=slow, output="sos")
    x = np.zeros((order, len(k)))
    x[0] = 1e-3
    queue = [np.zeros(len(k)) for _ in range(model.simulation.computation_delay_ticks)]
    s1 = s2 = estimate = slope = np.zeros(len(k))
    before = x[0].copy()
    ticks = round(seconds * fast)
    seen = np.empty((ticks, len(k)))
    gain, per_effort = (np.zeros(3), 0.0) if observer is None else observer_of(slow, *observer)
    state, given = np.zeros((3, len(k))), np.zeros(len(k))  # of the observer; efforts since its last sample
    for i in range(ticks):
        if i % every == 0:
            raw, before = (x[0] - before) * slow, x[0].copy()
            last, estimate = estimate, b0 * raw + s1
            s1, s2 = b1 * raw - a1 * estimate + s2, b2 * raw - a2 * estimate
            if observer is not None:
                state[2] += per_effort * given / every
                state = CHAIN @ state
                state[2] -= per_effort * given / every
                state += gain[:, None] * (x[0] - state[0])
                estimate, given = state[1] * slow, np.zeros(len(k))
            slope = (estimate - last) / every
        velocity = estimate + slope * (i % every) if extrapolate else estimate
        queue.append(-(k * x[0] + b * velocity))
        seen[i] = queue[-1]
        x = phi @ x + gamma * queue[0]
        given = given + queue.pop(0)
        scale = np.maximum(np.abs(x).max(axis=0), 1.0)  # a loop that grows stays within numbers
        assert (scale < 1e250).all()
    window = np.hanning(ticks // 3)[:, None]
    parts = seen[-2 * len(window) : -len(window)], seen[-len(window) :]
    return [np.sqrt((window * part**2).mean(axis=0)) for part in parts]


CHAIN = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])


def observer_of(rate: int, frequency_hz: float, inertia: float) -> Any:
    """Return gains of the disturbance observer by scipy, and acceleration per unit of effort (per period²)."""
    poles = np.exp(2.0 * np.pi * frequency_hz / rate * np.roots([1.0, 2.0, 2.0, 1.0]))
    placed = place_poles(CHAIN.T, CHAIN[:1].T, poles)
    return placed.gain_matrix[0], 1.0 / (inertia * rate**2)


CASES = {  # the first three run by default
    "rigid, dual": (RIGID, "dual:20k/2k", {"rates": (20_000, 2_000), "cutoff_hz": 200.0}, 0.3, 0.5, None),
    "two masses, one tick late, extrapolated, no lag": (
        with_delay(without_lag(KOUL), 1), "dual:10k/2k,cutoff_hz=200,prediction=extrapolate",
        {"rates": (10_000, 2_000), "cutoff_hz": 200.0, "extrapolate": True}, 0.5, 0.5, None,
    ),
    "observer, dual": (
        RIGID, "dual:20k/2k,estimator=disturbance,frequency_hz=120,inertia=8e-4",
        {"rates": (20_000, 2_000), "cutoff_hz": 200.0, "observer": (120.0, 8e-4)}, 0.3, 0.5, None,
    ),
    "by hand, dual": (KOUL, "dual:20k/2k", {"rates": (20_000, 2_000), "cutoff_hz": 200.0}, 2.0, 0.6, "firm"),
    "two masses, two ticks late": (
        with_delay(KOUL, 2), "dual:20k/2k,cutoff_hz=200",
        {"rates": (20_000, 2_000), "cutoff_hz": 200.0}, 1.0, 0.6, None,
    ),
    "by hand, one tick late, undamped": (
        with_delay(KOUL, 1), "uniform:20k", {"rates": (20_000, 20_000), "cutoff_hz": 2_000.0}, 0.0, 2.0, "normal",
    ),
    "observer, two ticks late, by hand": (
        with_delay(KOUL, 2), "uniform:20k,estimator=disturbance,frequency_hz=200,inertia=1.77e-3",
        {"rates": (20_000, 20_000), "cutoff_hz": 200.0, "observer": (200.0, 1.77e-3)}, 0.1, 1.0, "normal",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", first_by_default(CASES, 3))
def test_simulation_grows_beyond_the_limit_and_decays_below(case: Any) -> None:
    model, scheme, timing, damping, seconds, grip = CASES[case]
    timing = {**timing, "seconds": seconds, "hand": None if grip is None else GRIPS[grip]}
    limit = theory.k_max(model, scheme, damping, operator=grip)
    assert 10.0 < limit.stiffness < 5000.0
    k = limit.stiffness * np.array([0.98, 1.02])
    before, after = envelopes(model, k, np.full(2, damping), **timing)
    assert after[0] < before[0]
    assert after[1] > before[1]


def test_a_simulation_finds_the_end_of_the_range_of_damping_and_the_island_beyond() -> None:
    """At 3.5 N·m·s/rad a soft wall grows, a stiff one decays, and a stiffer one grows again."""
    limit = theory.k_max("koul-compliant", "dual:20k/2k", 3.5)
    (island,) = limit.islands
    assert limit.stiffness == 0.0
    k = np.array([0.9 * island.low, 1.1 * island.low, 0.98 * island.high, 1.02 * island.high])
    before, after = envelopes(KOUL, k, np.full(4, 3.5), rates=(20_000, 2_000), cutoff_hz=200.0, seconds=0.4)
    assert (after > before).tolist() == [True, False, False, True]


def characteristic_radius(model: Any, k: Any, b: Any, *, rate: Any, cutoff_hz: Any = None) -> Any:
    """Return the largest root of den·q + num·p for a uniform loop: law p/q, held plant num/den, no lifting."""
    a, into = plant(model)
    order = len(a)
    sensed = np.eye(order)[:1]
    phi, gamma = cont2discrete((a, into, sensed, np.zeros((1, 1))), 1.0 / rate)[:2]
    num, den = ss2tf(phi, gamma, sensed, np.zeros((1, 1)))
    upper, lower = rate * np.array([1.0, -1.0]), np.array([1.0, 0.0])  # (z − 1)/(T z)
    if cutoff_hz is not None:
        filtered = butter(2, cutoff_hz, fs=rate)
        upper, lower = np.polymul(upper, filtered[0]), np.polymul(lower, filtered[1])
    law = np.polyadd(k * lower, b * upper)
    lower = np.concatenate([lower, np.zeros(model.simulation.computation_delay_ticks)])
    return np.abs(np.roots(np.polyadd(np.polymul(den, lower), np.polymul(num[0], law)))).max()


@pytest.mark.parametrize("model", [RIGID, without_lag(RIGID), KOUL, without_lag(KOUL)])
@pytest.mark.parametrize(
    ("rate", "cutoff_hz", "ticks"), [(1_000, 100.0, 3), (2_000, None, 0), (4_000, 800.0, 1)]
)
def test_uniform_loop_has_the_roots_of_its_polynomial(
    model: Any, ticks: int, rate: int, cutoff_hz: float | None
) -> None:
    delayed = with_delay(model, ticks)
    scheme = f"uniform:{rate},estimator=fdm" if cutoff_hz is None else f"uniform:{rate},cutoff_hz={cutoff_hz}"
    walls = [(30.0, 0.0), (300.0, 0.5), (1500.0, 0.1), (5.0, 3.0)]
    k, b = np.array(walls).T
    exact = [characteristic_radius(delayed, *wall, rate=rate, cutoff_hz=cutoff_hz) for wall in walls]
    assert theory.spectral_radius(delayed, scheme, k, b) == pytest.approx(exact, rel=1e-6)


def test_dual_rate_with_one_rate_is_uniform() -> None:
    k, b = np.geomspace(1.0, 1e4, 30)[:, None], np.linspace(0.0, 2.0, 7)
    dual = theory.spectral_radius("koul-compliant", "dual:5k/5k", k, b)
    assert dual == pytest.approx(theory.spectral_radius("koul-compliant", "uniform:5k", k, b), rel=1e-12)
    assert dual.shape == (30, 7)


@pytest.mark.parametrize(
    ("scheme", "damping"),
    [("uniform:20k", 0.0), ("dual:20k/2k", 0.1), ("dual:20k/1k", 0.0), ("dual:20k/400,cutoff_hz=40", 0.0)],
)
def test_the_frequency_of_the_mode_is_not_aliased_to_the_velocity_rate(scheme: str, damping: float) -> None:
    """The capstan mode is near 628 Hz, also where T2 aliases it to 372 Hz (1 kHz) or 172 Hz."""
    limit = theory.k_max("koul-compliant", scheme, damping, operator="normal")
    assert limit.frequency_hz == pytest.approx(628.2, rel=1e-3)


def test_a_rig_may_be_a_name_a_file_an_experiment_or_a_model(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('preset = "koul-rigid"\n[wall]\nstiffness = 100.0\n')
    experiment = presets.load("koul-rigid")
    radii = [
        float(theory.spectral_radius(rig, "dual:20k/2k,cutoff_hz=200", 100.0, 0.1))
        for rig in ("koul-rigid", str(file), file, experiment, config.rig_model(experiment))
    ]
    assert radii == pytest.approx([radii[0]] * 5, rel=1e-12)
    assert float(theory.spectral_radius("koul-rigid", None, 100.0, 0.1)) == pytest.approx(radii[0], rel=1e-12)


def test_a_hand_takes_the_end_mass_off_and_none_leaves_it_on() -> None:
    held, free = theory.resolve("koul-compliant", "normal"), theory.resolve("koul-compliant", "none")
    assert held.operator == GRIPS["normal"]
    assert held.model.mechanics.end_mass == 0.0
    assert free.model.mechanics.end_mass == 0.07
    assert theory.resolve("koul-compliant").operator is None
    assert theory.resolve(KOUL, GRIPS["firm"]).operator == GRIPS["firm"]


def test_an_observer_has_the_inertia_of_the_rig_in_the_hand() -> None:
    """A bug gave an observer in a chosen hand the end mass of a trial without a person: 3.2 times the inertia."""
    for kind in ("constant-effort", "human"):
        changes = {"trial.kind": kind, "rig.limits.human": False, "controller.estimator": "disturbance"}
        x = config.override(presets.load("koul-rigid"), changes)
        for hand in ("normal", "none", None):
            loop: Any = theory.linear_loop(x, operator=hand)
            assert loop.estimator.of_effort.d * loop.subject.inertia == pytest.approx(4.294e-4, rel=1e-3)


def test_invalid_rigs_and_schemes_are_refused() -> None:
    for rig, scheme, operator, message in (
        ("koul-stiff", "uniform:1k", None, "koul-stiff"),
        ("nowhere/rig.toml", "uniform:1k", None, "nowhere"),
        ("koul-rigid", "uniform:1k", "iron", "unknown grip 'iron'"),
        ("koul-rigid", "dual:20k/3k", None, "multiple"),
        ("koul-rigid", "uniform:1k,estimator=levant", None, "levant is not linear"),
        ("koul-rigid", "dual:20k/2k,slow_velocity_rate=500,slow_below=0.1", None, "500 Hz below 0.1"),
        (RIGID, None, None, "no sampling scheme"),
        (RIGID, "dual:20k/3k", None, "not a multiple"),
    ):
        with pytest.raises(ConfigError, match=message):
            theory.spectral_radius(rig, scheme, 1.0, 0.0, operator=operator)


@pytest.mark.parametrize(
    ("rig", "operator", "scheme"),
    [
        ("koul-compliant", "normal", "dual:20k/2k"),
        ("koul-rigid", "none", "uniform:1k,estimator=fdm"),
        ("cogged", "none", "uniform:20k"),
    ],
)
def test_powers_of_the_period_agree_with_its_eigenvalues(rig: str, operator: str, scheme: str) -> None:
    """Walls range from none (an eigenvalue of 1) to those whose powers overflow, and are dense near the limits."""
    cogged = config.override(CHAWDA, COGS)
    loop = theory.linear_loop(cogged if rig == "cogged" else rig, scheme, operator=operator)
    lifted = theory.Lifted.of(loop)
    b = np.linspace(0.0, 1.2 * theory.damping_range(lifted), 6)
    edges = np.array([limit.stiffness for limit in theory.k_max_curve(lifted, None, b)])
    near = edges * (1.0 + np.geomspace(1e-8, 0.1, 8) * np.array([[1.0], [-1.0]])).reshape(-1, 1)
    for k in (np.append(0.0, np.geomspace(1e-3, 1e25, 100))[:, None], near):
        stable = lifted.stable(k, b)
        np.testing.assert_array_equal(stable, lifted.radius(k, b) < 1.0)
        assert 0 < np.count_nonzero(stable) < stable.size
    assert lifted.stable([], 1.0).shape == (0,)


CHAWDA = presets.load("chawda-linear")
COGS = {f"rig.cogging.{key}": value for key, value in
        {"period": 0.02, "orders": [1], "cosine": [0.0], "sine": [0.5]}.items()}  # fmt: skip
SLOPE = 0.5 * 2.0 * math.pi / 0.02  # N/m


def test_cogging_is_a_spring_at_the_motor_where_it_is_stiffest_and_where_it_is_softest() -> None:
    """Without a wall m·s² + b·s + k = 0 gives the radius over a velocity period, e^(Re s·T2), in closed form."""
    experiment = config.override(CHAWDA, COGS)
    mass, damping = 0.52, 13.2
    loop = theory.linear_loop(experiment, "uniform:1k")
    assert loop.softest is not None
    assert (loop.softest.cogging, loop.cogging) == pytest.approx((-SLOPE, SLOPE), rel=2e-3)
    lifted = theory.Lifted.of(loop)
    assert lifted.softest is not None
    for place in (lifted, lifted.softest):
        k = place.loop.cogging
        s = (-damping + cmath.sqrt(damping**2 - 4.0 * mass * k)) / (2.0 * mass)
        alone = replace(place, softest=None)
        assert float(alone.radius(0.0, 0.0)) == pytest.approx(math.exp(s.real * 1e-3), rel=1e-9)
    assert float(lifted.softest.radius(0.0, 0.0)) > 1.0 > float(lifted.softest.radius(1.1 * SLOPE, 0.0))
    # Softer than the detents: it slides, and oscillates nowhere.
    assert float(lifted.radius(0.9 * SLOPE, 0.0)) < 1.0


def test_a_wall_is_judged_at_the_worse_place_from_it_to_the_end_of_the_window() -> None:
    loop = theory.linear_loop(config.override(CHAWDA, COGS), "uniform:1k")
    lifted = theory.Lifted.of(loop)
    stiffness = np.array([2.0 * SLOPE, 2e3, 1e4, 2.6e4, 3e4])
    places = [replace(place, softest=None) for place in (lifted, lifted.softest) if place is not None]
    both = [place.radius(stiffness, 20.0) for place in places]
    np.testing.assert_array_equal(lifted.radius(stiffness, 20.0), np.maximum(*both))
    worse = min(theory.k_max(place, None, 20.0).highest for place in places)
    assert theory.k_max(lifted, None, 20.0).stiffness == pytest.approx(worse, rel=1e-6)
    # A window that ends before the slope turns: cogging there only softens the wall.
    short = {"rig.limits.position_maximum": 0.004, "trial.effort": 1.0, "trial.minimum_rest_counts": 0.0}
    near = theory.linear_loop(config.override(CHAWDA, {**COGS, **short}), "uniform:1k")
    assert near.softest is not None
    assert (near.cogging, near.softest.cogging) == (0.0, pytest.approx(-SLOPE, rel=2e-3))
    assert theory.linear_loop(CHAWDA, "uniform:1k").softest is None
