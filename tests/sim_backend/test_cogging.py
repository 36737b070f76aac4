"""Simulated motor cogging against a pendulum's closed form, energy conservation, and plants without cogging."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.special import ellipk

from rig.core.model import Cogging, Operator, RigModel
from rig.core.operators import GRIPS
from sim_backend.mechanics.plant import DiscretePlant, advance, energy
from tests.sim_backend.test_plant import CAPSTAN, LINEAR, run

TICK_S = 1e-4
LOSSLESS = replace(CAPSTAN, mechanics=replace(CAPSTAN.mechanics, transmission_damping_ratio=0.0))
ELASTIC = replace(GRIPS["normal"], pads_damping=0.0, hand_damping=0.0)
PERIODS = {"linear": 0.024, "rotary": 2.0 * math.pi / 10.0}
EFFORTS = {"linear": 1.0, "rotary": 0.01}


def cogging(rig: RigModel, *harmonics: tuple[int, float, float]) -> RigModel:
    """Return the rig with cogging harmonics (order, cosine, sine), as shares of a usual effort."""
    orders, cosine, sine = zip(*harmonics, strict=True)
    scale = EFFORTS[rig.motion]
    given = Cogging(
        period=PERIODS[rig.motion],
        orders=orders,
        cosine=tuple(scale * c for c in cosine),
        sine=tuple(scale * s for s in sine),
    )
    return replace(rig, cogging=given)


def test_a_free_motor_that_cogs_swings_like_a_pendulum() -> None:
    """Check m·x″ = −A·sin(k·x) for one harmonic: its period is 4·K(sin²(k·x₀/2))/√(A·k/m), far from linear here."""
    k, amplitude, start = 2.0 * math.pi / PERIODS["linear"], 1.0, 2.5
    plant = DiscretePlant.build(cogging(LINEAR, (1, 0.0, -amplitude)), 1e-3)  # of twenty inner steps
    period_s = 4.0 * ellipk(math.sin(0.5 * start) ** 2) / math.sqrt(amplitude * k / 0.52)
    state = plant.at_rest(start / k)
    position = run(plant, round(2.2 * period_s / 1e-3), state=state)[:, 0]
    falls = np.flatnonzero((position[:-1] > 0.0) & (position[1:] <= 0.0))
    passed = falls + position[falls] / (position[falls] - position[falls + 1])
    assert (passed[1] - passed[0]) * 1e-3 == pytest.approx(period_s, rel=1e-6)


@pytest.mark.parametrize("rig", [LINEAR, LOSSLESS], ids=["rigid", "two-mass"])
@pytest.mark.parametrize("hand", [None, ELASTIC], ids=["free", "held"])
@settings(max_examples=4)
@example(harmonics=[(1, 0.0, 0.0)], speed=9.3e-23)
@given(
    harmonics=st.lists(
        st.tuples(
            st.sampled_from([1, 7, 12]),
            st.floats(-1.0, 1.0, allow_subnormal=False),
            st.floats(-1.0, 1.0, allow_subnormal=False),
        ),
        min_size=1,
        max_size=3,
        unique_by=lambda harmonic: harmonic[0],
    ),
    speed=st.floats(-0.2, 0.2, allow_subnormal=False),
)
def test_cogging_conserves_energy(rig: RigModel, hand: Operator | None, harmonics: Any, speed: float) -> None:
    """Over a second the energy varies by the error of a leapfrog step and does not drift."""
    model = cogging(rig, *harmonics).held_by(hand, None)
    plant = DiscretePlant.build(model, 0.02)  # of many inner steps
    state = plant.at_rest(0.1 * PERIODS[rig.motion])
    for place in {plant.sensed_position, plant.handle_position}:
        state[place + 1] = speed / rig.mechanics.handle_radius
    at = [energy(state, model)]
    for _ in range(50):
        advance(plant.arguments(state), 0.0, 0.0)
        at.append(energy(state, model))
    held = sum(abs(c) + abs(s) for _, c, s in harmonics) * EFFORTS[rig.motion] * PERIODS[rig.motion]
    scale = 0.5 * model.mechanics.motor_inertia * (speed / rig.mechanics.handle_radius) ** 2 + held
    rounding = 1e-9 * EFFORTS[rig.motion] * PERIODS[rig.motion]  # of a rig at rest, without harmonics
    scale += rounding
    assert np.ptp(at) <= 2e-3 * scale
    assert abs(np.mean(at[-10:]) - np.mean(at[:10])) <= 1e-3 * scale


@pytest.mark.parametrize(
    ("rig", "hand", "lag_s"),
    [
        (LINEAR, None, 2e-4), (LINEAR, GRIPS["normal"], 0.0), (LOSSLESS, None, 0.0), (LOSSLESS, GRIPS["normal"], 2e-4),
    ],
)  # fmt: skip
def test_a_motor_that_hardly_cogs_moves_freely(rig: RigModel, hand: Operator | None, lag_s: float) -> None:
    scale = EFFORTS[rig.motion]
    rubs = replace(
        rig.mechanics, motor_coulomb=0.1 * scale, link_coulomb=0.07 * scale, link_damping=0.1 * scale
    )
    rig = replace(rig, mechanics=rubs, amplifier=replace(rig.amplifier, lag_s=lag_s))
    free = DiscretePlant.build(rig.held_by(hand, None), TICK_S)
    full = DiscretePlant.build(cogging(rig, (3, 0.0, 0.0)).held_by(hand, None), TICK_S)
    assert full.cogs
    assert not free.cogs
    a, b = free.at_rest(0.0), full.at_rest(0.0)
    pairs = [(free.sensed_position, full.sensed_position), (free.handle_position, full.handle_position)]
    if free.hand_position is not None:
        pairs.append((free.hand_position, full.hand_position or 0))
    for tick in range(150):
        command = 0.4 * scale * math.sin(2.0 * math.pi * tick / 150.0)
        push = command, 0.05 * scale
        assert advance(free.arguments(a), *push) == advance(full.arguments(b), *push)
        for here, there in pairs:
            assert b[there : there + 2] == pytest.approx(a[here : here + 2], rel=1e-9, abs=1e-13)
        assert b[full.effort] == pytest.approx(a[free.effort], rel=1e-9, abs=1e-13)
        assert b[full.edge_age] == pytest.approx(a[free.edge_age], rel=1e-6, abs=1e-9)
    assert abs(a[free.sensed_position + 1]) > 0.0


@pytest.mark.parametrize("rig", [LINEAR, LOSSLESS], ids=["rigid", "two-mass"])
def test_friction_holds_a_motor_that_cogs_to_the_last_bit_until_both_are_overcome(rig: RigModel) -> None:
    """At a peak of cogging, a push along it breaks away at Coulomb − cogging, a push against it at their sum."""
    scale, share = EFFORTS[rig.motion], 0.3
    rig = replace(
        rig,
        mechanics=replace(rig.mechanics, motor_coulomb=scale),
        amplifier=replace(rig.amplifier, lag_s=0.0),
    )
    plant = DiscretePlant.build(cogging(rig, (1, share, 0.0)), TICK_S)
    for command, holds in (
        ((1.0 - share) * 0.999, True),
        ((1.0 - share) * 1.001, False),
        (-(1.0 + share) * 0.999, True),
        (-(1.0 + share) * 1.001, False),
    ):
        state = plant.at_rest(0.0)
        moved = run(plant, 50, state=state, command=command * scale)[:, plant.sensed_position]
        assert bool(np.all(moved == 0.0)) is holds
        if not holds:
            assert np.sign(moved[-1]) == np.sign(command)


def rippling(shares: dict[int, Any], lag_s: float, period: float = PERIODS["linear"]) -> RigModel:
    """Return a mass moved by its motor alone, whose effort varies by these shares (order: cosine, sine)."""
    orders, zeros = tuple(shares), (0.0,) * len(shares)
    cosine, sine = zip(*shares.values(), strict=True)
    return replace(
        LINEAR,
        mechanics=replace(LINEAR.mechanics, motor_damping=0.0, motor_coulomb=0.0),
        amplifier=replace(LINEAR.amplifier, lag_s=lag_s),
        cogging=Cogging(
            period=period, orders=orders, cosine=zeros, sine=zeros, ripple_cosine=cosine, ripple_sine=sine
        ),
    )


def test_an_effort_that_ripples_does_the_work_of_its_integral_over_the_way() -> None:
    """Check that ∫ u·(1 + r(x)) dx from rest is the kinetic energy; the current sensor measures u."""
    command, shares = 2.0, {1: (0.05, -0.1), 5: (0.08, 0.02)}
    plant = DiscretePlant.build(rippling(shares, 0.0), 1e-3)
    rows = run(plant, 150, state=plant.at_rest(0.0), command=command)
    x, v = rows[:, 0], rows[:, 1]
    angle = np.multiply.outer(x, 2.0 * math.pi / PERIODS["linear"] * np.array(list(shares)))
    cosine, sine = np.array(list(shares.values())).T
    wave = 2.0 * math.pi / PERIODS["linear"] * np.array(list(shares))
    work = command * (x + np.sin(angle) @ (cosine / wave) - np.cos(angle) @ (sine / wave))
    kinetic = 0.5 * 0.52 * v**2
    assert x[-1] > 1.5 * PERIODS["linear"]
    assert kinetic - kinetic[0] == pytest.approx(work - work[0], rel=1e-5, abs=1e-6 * work[-1])
    assert rows[-1, plant.effort] == command


@pytest.mark.parametrize("lag_s", [0.0, 1e-5, 3e-4, 1e-2])
def test_a_ripple_that_is_the_same_everywhere_is_a_larger_torque_constant(lag_s: float) -> None:
    """Velocities are 1 + r times as large to the last digits, also while the effort still rises to its command."""
    even, larger = (
        DiscretePlant.build(rippling({1: (share, 0.0)}, lag_s, period=1e9), 1e-4) for share in (0.0, 0.07)
    )
    a, b = (run(plant, 20, state=plant.at_rest(0.0), command=1.5)[:, 1] for plant in (even, larger))
    assert b == pytest.approx(1.07 * a, rel=1e-9)
    assert a[-1] > 0.0


def test_effort_slope_and_energy_are_derivatives_of_each_other() -> None:
    given = cogging(LOSSLESS, (1, 0.3, -0.2), (14, -0.5, 1.0)).cogging
    at, step = np.linspace(-0.7, 0.7, 101), 1e-6
    rise = (given.energy(at + step) - given.energy(at - step)) / (2.0 * step)
    assert -rise == pytest.approx(given.effort(at), abs=1e-9)
    rise = (given.effort(at + step) - given.effort(at - step)) / (2.0 * step)
    assert rise == pytest.approx(given.slope(at), abs=1e-6)
