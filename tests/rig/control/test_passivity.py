"""The passivity controller: limits of its added damping, and a wall that generates energy only without it."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

import rig
from rig.config import controller as controllers
from rig.control import _passivity as passivity
from rig.core.errors import ConfigError

TICK_S = 1e-3
REACTION = st.floats(0.0, 50.0, allow_subnormal=False)
ENERGY = st.floats(-1.0, 1.0, allow_subnormal=False)
SPEED = st.floats(-5.0, 5.0, allow_subnormal=False)
ROUNDING = 1e-12


@given(reaction=REACTION, energy=ENERGY, inwards=SPEED, limit=st.floats(1e-3, 100.0))
def test_added_effort_takes_energy_within_its_limit_and_never_reverses_the_wall(
    reaction: float, energy: float, inwards: float, limit: float
) -> None:
    damped = passivity.add_damping(reaction, energy, inwards, limit, TICK_S)
    added = damped - reaction
    assert added * inwards >= 0.0
    assert abs(added) <= limit * abs(inwards) * (1.0 + ROUNDING) + ROUNDING
    assert added * inwards * TICK_S <= max(energy, 0.0) + ROUNDING
    assert damped >= 0.0


@given(reaction=REACTION, inwards=SPEED)
def test_a_passive_wall_is_left_alone(reaction: float, inwards: float) -> None:
    assert passivity.add_damping(reaction, 0.0, inwards, 10.0, TICK_S) == reaction
    assert passivity.add_damping(reaction, -0.5, inwards, 10.0, TICK_S) == reaction


def test_a_wall_that_pulls_already_is_not_made_to_push() -> None:
    """On the way out added damping lowers the reaction; a reaction below zero stays unchanged."""
    assert passivity.add_damping(-2.0, 0.1, -1.0, 10.0, TICK_S) == -2.0


@pytest.mark.parametrize(("limit", "passive"), [(0.0, False), (1.0, True)])
def test_the_controller_takes_back_the_energy_of_an_undamped_sampled_wall(
    limit: float, passive: bool
) -> None:
    """A sampled and held spring adds energy at each bounce: the handle leaves faster than it came."""
    experiment = rig.load(
        "koul-rigid",
        stiffness=250.0,
        damping=0.0,
        changes={
            "controller.position_rate": 1000,
            "controller.velocity_rate": 1000,
            "controller.parameters.cutoff_hz": 400.0,
            "wall.passive_damping": limit,
        },
    )
    hit = rig.hit(experiment)
    assert (hit.verdict.kind == "stable") is passive


def test_the_position_of_the_estimator_needs_one_that_has_it_and_an_estimate_in_every_tick() -> None:
    x = rig.load("koul-rigid")
    slow = {"wall.position_from": "estimator"}
    with pytest.raises(ConfigError, match="needs an estimate in every tick"):
        rig.load("koul-rigid", changes=slow)
    uniform = dataclasses.replace(
        x,
        controller=dataclasses.replace(x.controller, velocity_rate=x.controller.position_rate),
        wall=dataclasses.replace(x.wall, position_from="estimator"),
    )
    with pytest.raises(ConfigError, match="estimates no position"):
        controllers.for_experiment(uniform, current_quantum_a=1e-3)
