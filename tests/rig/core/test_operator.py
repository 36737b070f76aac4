"""A person in the model and in an experiment: grips, impedance, and a hand that pushes in place of the motor."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rig import config
from rig.config import controller, override, presets
from rig.core.errors import ConfigError
from rig.core.model import Operator, StateSpace, state_space
from rig.core.operators import GRIPS
from rig.devices import simulated_model
from rig.devices.device import DeviceUrl
from rig.experiments.trials.plan import make_plan, predict_impact

KOUL, RIGID, CHAWDA = (presets.load(name) for name in ("koul-compliant", "koul-rigid", "chawda-linear"))
HUMAN = {"trial.kind": "human", "rig.limits.human": False}  # the motor of an automated trial, for firm hands


def held(base: config.Experiment = KOUL, **changes: Any) -> config.Experiment:
    return override(base, {**HUMAN, **{key.replace("__", "."): value for key, value in changes.items()}})


# Grips


# Impedance


def impedance_at_handle(operator: Operator, s: complex) -> complex:
    """Return force over velocity (N·s/m) of pads on a hand at its intended position, as a ladder network."""
    hand = operator.hand_mass * s + operator.hand_damping + operator.hand_stiffness / s
    pads = operator.pads_damping + operator.pads_stiffness / s
    return operator.pads_mass * s + 1.0 / (1.0 / pads + 1.0 / hand)


def admittance(model: StateSpace, state: int, source: int, s: complex) -> complex:
    return complex(np.linalg.solve(s * np.eye(model.order) - model.a, model.b[:, source])[state])


@pytest.mark.parametrize("grip", sorted(GRIPS))
@pytest.mark.parametrize("frequency_hz", [1.0, 10.0, 60.0, 600.0])
@pytest.mark.parametrize("base", [RIGID, CHAWDA, KOUL], ids=["rotary", "linear", "two masses"])
def test_a_hand_adds_the_impedance_of_pads_and_hand_at_the_handle(
    base: config.Experiment, frequency_hz: float, grip: str
) -> None:
    mechanics, amplifier, operator = base.rig.mechanics, base.rig.amplifier, GRIPS[grip]
    s = 2j * math.pi * frequency_hz
    free = state_space(mechanics, amplifier)
    both = state_space(mechanics, amplifier, operator)
    velocity = free.handle_position + 1
    added = 1.0 / admittance(both, velocity, 1, s) - 1.0 / admittance(free, velocity, 1, s)
    assert added == pytest.approx(mechanics.handle_radius**2 * impedance_at_handle(operator, s), rel=1e-8)


def test_the_rig_rests_at_the_intended_position_of_the_hand() -> None:
    both = state_space(KOUL.rig.mechanics, KOUL.rig.amplifier, GRIPS["normal"])
    wanted = both.operator_inputs.start
    rest = np.linalg.solve(both.a, -both.b[:, wanted] * 0.02)
    assert rest[[both.sensed_position, both.handle_position, both.hand_position]] == pytest.approx([0.02] * 3)
    pressed = np.linalg.solve(both.a, -both.b[:, wanted + 2] * 0.4)
    assert pressed[both.hand_position] == pytest.approx(0.4 / (300.0 * 0.01))


# Experiments


def test_with_a_person_the_motor_pushes_nothing_and_the_end_mass_is_off() -> None:
    experiment = held()
    model = config.rig_model(experiment)
    assert model.operator == GRIPS["normal"]
    assert model.mechanics == replace(KOUL.rig.mechanics, end_mass=0.0)
    assert model.reach is not None
    assert model.reach.target == pytest.approx(0.02)  # 2 mm at 0.1 m
    assert (model.reach.start, model.reach.pace, model.reach.wait_s) == (-0.015, 0.1, 0.25)
    law = controller.for_experiment(experiment, current_quantum_a=0.001)
    assert law.control["constant_effort"][0] == 0.0


def test_the_device_knows_that_a_person_may_hold_the_handle_still() -> None:
    for experiment, expected in ((KOUL, 0), (held(), 1)):
        values = controller.prepare_controller(
            experiment, current_quantum_a=0.001, reference_count=0, verified=True
        ).parameters
        assert values["hold_to_run"] == expected


def test_a_grip_brings_its_numbers_and_single_ones_may_be_set() -> None:
    assert held(operator__grip="firm").operator == GRIPS["firm"]
    stronger = held(operator__grip="firm", operator__press=7.0)
    assert stronger.operator == replace(GRIPS["firm"], press=7.0)
    assert override(stronger, {"operator.press": 6.5}).operator == replace(GRIPS["firm"], press=6.5)
    # Numbers of a grip do not outlive it.
    assert override(stronger, {"operator.grip": "relaxed"}).operator == GRIPS["relaxed"]
    from_file = config.experiment_from_mapping(
        {"preset": "koul-rigid", "trial": {"kind": "human"}, "operator": {"grip": "relaxed", "depth": 0.003}},
        "x",
    )
    assert from_file.operator == replace(GRIPS["relaxed"], depth=0.003)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"operator.grip": "frim"}, 'operator.grip = "frim": must be one of "relaxed", "normal", "firm"'),
        ({"operator.hand_mass": 0.0}, "operator.hand_mass = 0.0: must be a number > 0 kg"),
        ({"operator.presss": 1.0}, "did you mean press?"),
        (
            {"trial.duration_s": 0.8},
            "operator.reach_s = 0.3 s: must end before the judged tail",
        ),
        ({"operator.press": 16.0}, "operator.press = 16.0 N: must leave the push, 1."),
        ({"operator.press": 0.5}, "operator.press = 0.5 N: must be at least "),
    ],
)  # fmt: skip
def test_an_operator_that_cannot_do_the_trial_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        override(KOUL, {**HUMAN, **changes})
    assert words in str(caught.value)


def test_rules_about_the_motors_push_do_not_bind_a_person() -> None:
    assert held(trial__effort=0.0).trial.effort == 0.0
    assert override(KOUL, {"trial.duration_s": 0.41}), "nor do a person's rules bind the motor"


def test_the_push_at_rest_is_that_of_springs_in_series() -> None:
    """The balance of handle, pads and hand, solved as equations; without a wall the push is zero."""
    for base in (KOUL, CHAWDA):
        experiment = held(base)
        o, radius = experiment.operator, experiment.rig.mechanics.handle_radius
        wall, k1, k2 = experiment.wall.stiffness / radius**2, o.pads_stiffness, o.hand_stiffness
        balance = np.array([[wall + k1, -k1], [-k1, k1 + k2]])
        handle, _ = np.linalg.solve(balance, [0.0, k2 * o.depth + o.press])
        assert config.push_at_rest(experiment) == pytest.approx(wall * handle * radius, rel=1e-12)
    assert config.push_at_rest(held(wall__stiffness=0.0)) == 0.0
    assert config.push_at_rest(KOUL) == 0.15


# Plan and command line


def test_the_plan_names_the_grip_and_checks_the_hand_behind_the_wall() -> None:
    for base in (KOUL, CHAWDA):
        for grip in GRIPS:
            plan = make_plan(held(base, operator__grip=grip))
            push = next(step.text for step in plan.steps if step.name == "push")
            assert f"hand with a {grip} grip, no motor" in push
            assert "after the wall" in [check.name for check in plan.checks]
            assert plan.ok
    assert "after the wall" not in [check.name for check in make_plan(KOUL).checks]
    far = make_plan(held(operator__hand_stiffness=5.0))
    assert [check.name for check in far.checks if check.outcome == "refused"] == ["after the wall"]


def test_the_predicted_impact_of_a_hand_is_of_the_size_of_the_simulated_one() -> None:
    """The simulation gives 0.566 rad/s for the normal grip."""
    assert predict_impact(held()).velocity == pytest.approx(0.566, rel=0.2)


def test_a_rig_named_in_the_url_is_held_by_the_person_of_the_experiment() -> None:
    url = DeviceUrl.parse("sim://koul-rigid")
    model = simulated_model(url, config.rig_model(held(RIGID, operator__grip="firm")))
    assert model is not None
    assert model.operator == GRIPS["firm"]
    assert model.mechanics.end_mass == 0.0
    free = simulated_model(url, config.rig_model(RIGID))
    assert free == config.rig_model(RIGID)
