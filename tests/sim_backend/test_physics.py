"""Laws of mechanics over structures, hands and step sizes; test_plant tests the free plant."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from rig.core.model import RigModel, Simulation, state_space
from rig.core.operators import GRIPS
from sim_backend.mechanics.plant import DiscretePlant, advance, energy
from tests.sim_backend.test_plant import FRICTIONLESS, LINEAR, ROTARY, run, with_mechanics

CAPSTAN = with_mechanics(ROTARY, motor_damping=0.0, link_damping=0.0, **FRICTIONLESS)
RELAXED, NORMAL = GRIPS["relaxed"], GRIPS["normal"]


def changed(rig: RigModel, inner_step_s: float = 5e-5, **mechanics: Any) -> RigModel:
    return replace(
        rig, mechanics=replace(rig.mechanics, **mechanics), simulation=Simulation(inner_step_s=inner_step_s)
    )


# Energy


@pytest.mark.parametrize("rig", [LINEAR, CAPSTAN], ids=["rigid", "two-mass"])
@given(
    start=st.lists(st.floats(-1.0, 1.0, allow_subnormal=False), min_size=6, max_size=6),
    coulomb=st.sampled_from([0.0, 0.3]),
)
@settings(max_examples=8)
def test_a_rig_in_a_relaxed_hand_that_wants_nothing_creates_no_energy(
    rig: RigModel, start: list[float], coulomb: float
) -> None:
    """Energy may rise only in a step in which a mass stops or turns, by at most the friction times its travel.

    The energy is that of both masses, the pads, the hand and all springs; the intended position is zero.
    """
    radius = rig.mechanics.handle_radius
    levels = (0.7 * coulomb * radius, 0.3 * coulomb * radius)
    rig = changed(rig, motor_coulomb=levels[0], link_coulomb=levels[1]).held_by(RELAXED, None)
    plant = DiscretePlant.build(rig, 1e-4)
    state = plant.at_rest(0.0)
    assert plant.hand_position is not None
    bodies = [plant.sensed_position, plant.handle_position, plant.hand_position]
    state[bodies] = (
        np.array(start[:3]) * [1e-2, 1e-2 if plant.handle_position == 0 else 1.01e-2, 3e-2] / radius
    )
    state[[b + 1 for b in bodies]] = np.array(start[3:]) * 0.3 / radius
    rubbing = {plant.sensed_position: levels[0], plant.handle_position: levels[1]}
    if len(rubbing) == 1:
        rubbing = {0: sum(levels)}
    first = left = energy(state, rig)
    for _ in range(400):
        before = state.copy()
        advance(plant.arguments(state), 0.0, 0.0)
        allowed = sum(
            level * abs(state[x] - before[x])
            for x, level in rubbing.items()
            if before[x + 1] * state[x + 1] <= 0.0
        )
        now = energy(state, rig)
        assert now <= left + allowed * (1 + 1e-6) + 1e-12 * first
        left = now


@pytest.mark.parametrize("rig", [LINEAR, CAPSTAN], ids=["rigid", "two-mass"])
def test_without_any_damping_the_energy_of_a_held_rig_stays(rig: RigModel) -> None:
    elastic = replace(NORMAL, pads_damping=0.0, hand_damping=0.0)
    rig = changed(rig, transmission_damping_ratio=0.0).held_by(elastic, None)
    plant = DiscretePlant.build(rig, 1e-4)
    assert plant.hand_position is not None
    state = plant.at_rest(0.0)
    state[plant.hand_position] = 0.02
    state[plant.sensed_position + 1] = 0.3
    first = energy(state, rig)
    energies = [energy(row, rig) for row in run(plant, 3000, state=state)]
    assert energies == pytest.approx([first] * 3000, rel=1e-10)


# Friction


@pytest.mark.parametrize("rig", [LINEAR, CAPSTAN], ids=["rigid", "two-mass"])
def test_a_press_below_the_friction_level_moves_the_hand_and_not_the_handle(rig: RigModel) -> None:
    radius = rig.mechanics.handle_radius
    rig = changed(rig, motor_coulomb=0.5 * radius, link_coulomb=1.2 * radius).held_by(NORMAL, None)
    plant = DiscretePlant.build(rig, 1e-4)
    assert plant.hand_position is not None
    start = plant.at_rest(0.1234)
    start[plant.intentions][2] = 1.1 * radius  # N: below what the link's side alone can carry
    rows = run(plant, 5000, state=start.copy())
    still = [
        plant.sensed_position,
        plant.sensed_position + 1,
        plant.handle_position,
        plant.handle_position + 1,
    ]
    assert (rows[:, still] == start[still]).all()
    give = 1.1 / (NORMAL.pads_stiffness + NORMAL.hand_stiffness) / radius
    assert rows[-1, plant.hand_position] - 0.1234 == pytest.approx(give, rel=1e-6)


# Linear motion


@pytest.mark.parametrize("operator", [RELAXED, NORMAL], ids=["relaxed", "normal"])
@pytest.mark.parametrize("rig", [LINEAR, CAPSTAN], ids=["rigid", "two-mass"])
def test_the_response_in_a_hand_is_that_of_one_matrix_exponential(rig: RigModel, operator: Any) -> None:
    """Compare a thousand steps with one exponential over 50 ms, from the continuous matrices."""
    rig = changed(rig, motor_damping=0.002, link_damping=0.001).held_by(operator, None)
    plant = DiscretePlant.build(rig, 5e-5)
    continuous = state_space(rig.mechanics, rig.amplifier, operator)
    order = continuous.order
    start = np.random.default_rng(3).standard_normal(order) * 0.01
    start[continuous.effort] = 0.0
    state = plant.at_rest(0.0)
    state[:order] = start
    wanted = state[plant.intentions]
    wanted[:] = np.array([0.02, -0.1, 0.3])[: len(wanted)]
    inputs = np.zeros(continuous.b.shape[1])
    inputs[continuous.operator_inputs] = wanted
    both = np.block([[continuous.a, (continuous.b @ inputs)[:, None]], [np.zeros((1, order + 1))]])
    end = run(plant, 1000, state=state)[-1, :order]
    assert end == pytest.approx((expm(both * 0.05) @ [*start, 1.0])[:order], rel=1e-9, abs=1e-12)


# Statics


@pytest.mark.parametrize("press", [20.0, -20.0])
def test_a_hand_that_presses_with_20_newton_rests_20_millimetres_inside_a_wall_of_1_kilonewton_a_metre(
    press: float,
) -> None:
    free_hand = replace(NORMAL, hand_stiffness=0.0)
    plant = DiscretePlant.build(changed(LINEAR, motor_damping=13.2).held_by(free_hand, None), 1e-3)
    assert plant.hand_position is not None
    state = plant.at_rest(0.0)
    state[plant.intentions] = 0.0, 0.0, press
    side = math.copysign(1.0, press)
    for _ in range(4000):
        penetration = side * state[plant.sensed_position]
        advance(plant.arguments(state), -1000.0 * side * max(0.0, penetration), 0.0)
    assert state[plant.sensed_position] == pytest.approx(side * 0.020, rel=1e-6)
    give = state[plant.hand_position] - state[plant.handle_position]
    assert give == pytest.approx(press / NORMAL.pads_stiffness, rel=1e-6)
