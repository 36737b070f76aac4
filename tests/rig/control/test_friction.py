"""Friction compensation reduces the friction that a slow hand feels, and cannot inject energy."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig import config
from rig.config import controller, presets
from rig.control import laws
from rig.control.friction import (
    DEFAULT_SHARE,
    Compensation,
    compensate_friction,
    compensation,
    dead_band_of,
)
from rig.control.step import step
from rig.core.errors import ConfigError
from rig.core.sample import Phase
from rig.testing import Hits
from sim_backend.mechanics.plant import DiscretePlant, advance

LEVEL = 0.02  # of koul-rigid (N·m)
FREE = config.override(
    presets.load("koul-rigid"),
    {
        "rig.mechanics.end_mass": 0.0,
        "wall.stiffness": 0.0,
        "wall.damping": 0.0,
        "trial.effort": 1e-12,
        "trial.minimum_rest_counts": 0.0,
        "trial.start": -1e-4,
        "trial.duration_s": 5.0,
        "homing.settle_s": 0.0,
        "homing.tolerance_counts": 1e6,
    },
)
DEAD_BAND = dead_band_of(FREE.rig.encoder.resolution, 2000.0, 200.0)

velocities = st.floats(-10.0, 10.0, allow_subnormal=False)
levels = st.floats(0.0, 1.0, allow_subnormal=False)


@given(
    velocity=velocities,
    estimate=velocities,
    up=levels,
    down=levels,
    share=st.floats(0.0, 0.99, allow_subnormal=False),
)
def test_friction_remains_dissipative(velocity: Any, estimate: Any, up: Any, down: Any, share: float) -> None:
    """Check u·v − level·|v| ≤ −(1 − share)·level·|v|; with a wrong direction the smaller level applies."""
    effort = compensation(estimate, up, down, 0.1, share)
    rubbing = up if velocity > 0.0 else down
    # By signs: the product of two small velocities is 0.
    opposite = (velocity > 0.0) is not (estimate > 0.0)
    largest = max(up, down) if opposite else rubbing
    given_power = effort * velocity
    assert abs(effort) <= share * max(up, down)
    if opposite or estimate == 0.0:
        assert given_power <= 0.0, "of the wrong sign it brakes"
    else:
        assert given_power - rubbing * abs(velocity) <= -(1.0 - share) * rubbing * abs(velocity) + 1e-12
    assert given_power <= share * largest * abs(velocity) + 1e-12


@given(velocity=velocities, share=st.floats(0.0, 0.99, allow_subnormal=False), level=levels)
def test_compensation_is_odd_and_smooth(velocity: Any, share: float, level: Any) -> None:
    effort = compensation(velocity, level, level, 0.5, share)
    assert compensation(-velocity, level, level, 0.5, share) == -effort
    assert compensation(0.0, level, level, 0.5, share) == 0.0
    if abs(velocity) >= 0.5:
        assert abs(effort) == share * level
    nearby = compensation(velocity + 1e-6, level, level, 0.5, share)
    assert abs(nearby - effort) <= 1.5 * share * level / 0.5 * 1e-6 + 1e-12, "slope 1.5·level/dead band"


@pytest.mark.parametrize(
    "wrong", [{"share": 1.0}, {"share": -0.1}, {"dead_band": 0.0}, {"up": -1.0}, {"down": float("nan")}]
)
def test_compensation_that_could_drive_the_rig_is_refused(wrong: Any) -> None:
    with pytest.raises(ConfigError):
        Compensation(**{"up": 0.02, "down": 0.02, "dead_band": 0.1, **wrong})


def bench(law: Any, external: Any, velocity: float = 0.0, seconds: float = 1.5, changes: Any = None) -> Any:
    """Simulate the law on koul-rigid, pushed by `external(tick, state)`; return states, efforts and pushes."""
    experiment = config.override(FREE, changes or {})
    rate = experiment.controller.position_rate
    plant = DiscretePlant.build(config.rig_model(experiment), 1.0 / rate)
    control = controller.for_experiment(
        experiment, current_quantum_a=experiment.rig.amplifier.current_quantum_a, law=law
    )
    state = plant.at_rest(0.0)
    state[1] = velocity
    states, efforts, pushes = [], [], []
    arguments, moving = control.arguments(), plant.arguments(state)
    count = plant.count(state)
    for tick in range(round(seconds * rate)):
        step(arguments, count, 1.0, 1, 0)
        push = external(tick / rate, state)
        states.append(state[:2].copy())
        efforts.append(float(control.memory["effort_sent"][0]))
        pushes.append(push)
        count = advance(moving, efforts[-1], push)
    return np.array(states), np.array(efforts), np.array(pushes)


@pytest.fixture(scope="module")
def free() -> Any:
    return laws.get("spring-damper")


@pytest.fixture(scope="module")
def helped(free: Any) -> Any:
    return compensate_friction(free, Compensation(up=LEVEL, down=LEVEL, dead_band=DEAD_BAND))


def hand_push(speed: Any) -> Any:
    """Return the push of a stiff, damped hand that moves the handle at a slow constant speed."""

    def push(time_s: Any, state: Any) -> Any:
        return 20.0 * (speed * time_s - state[0]) + 0.2 * (speed - state[1])

    return push


def test_a_slow_hand_feels_less_than_half_of_the_friction(free: Any, helped: Any) -> None:
    felt, speed = {}, -0.4
    for name, law in (("off", free), ("on", helped)):
        _, _, pushes = bench(law, hand_push(speed), seconds=0.25)
        felt[name] = abs(pushes[len(pushes) // 2 :].mean())
    viscous = 0.003 * abs(speed)
    assert felt["off"] - viscous == pytest.approx(LEVEL, rel=0.02)
    assert felt["on"] - viscous < 0.5 * LEVEL
    assert felt["on"] - viscous == pytest.approx((1.0 - DEFAULT_SHARE) * LEVEL, abs=0.1 * LEVEL)


@pytest.mark.parametrize("rate", [20_000, 1000])
def test_compensation_injects_no_net_energy(helped: Any, rate: int) -> None:
    """Under random pushes the motor's work never exceeds what friction dissipates."""
    rng = np.random.default_rng(5)
    pushes = np.repeat(rng.normal(0.0, 0.05, 50), rate // 100)
    changes = {"controller.position_rate": rate, "controller.velocity_rate": min(rate, 2000),
               "controller.parameters.cutoff_hz": 0.1 * min(rate, 2000)}  # fmt: skip
    states, efforts, _ = bench(
        helped,
        lambda time_s, state: float(pushes[min(int(time_s * rate), len(pushes) - 1)]),
        seconds=0.5,
        changes=changes,
    )
    way = np.diff(states[:, 0])
    work = np.cumsum(efforts[:-1] * way)
    rubbed = np.cumsum(LEVEL * np.abs(way))
    assert np.abs(efforts).max() > 0.9 * DEFAULT_SHARE * LEVEL
    quantum = 0.234e-3  # effort is rounded, up to half of it too much
    assert (work <= (DEFAULT_SHARE + 0.5 * quantum / LEVEL) * rubbed + 1e-12).all()


def test_the_wall_stays_the_wall_and_each_direction_has_its_level(free: Any) -> None:
    wall = {"stiffness": 300.0, "damping": 0.5, "pull": "clamp", "damping_on": "both", "side": 1}
    law = compensate_friction(free, Compensation(up=0.03, down=0.01, dead_band=0.1, share=0.5))
    run = law.function
    for side, inwards in ((1, 0.03), (-1, 0.01)):
        prepared = law.prepare({**wall, "side": side})
        plain = free.prepare({**wall, "side": side})
        for penetration, velocity in ((1e-3, 1.0), (-1e-3, 1.0), (1e-3, -0.2), (1e-3, 0.0)):
            reaction = run(penetration, velocity, 1, prepared.state, prepared.parameters)
            alone = free.function(penetration, velocity, 1, plain.state, plain.parameters)
            outwards = 0.04 - inwards
            along = 0.5 * (inwards if velocity > 0 else -outwards if velocity < 0 else 0.0)
            assert reaction == pytest.approx(alone - along)
            assert prepared.state[0] == plain.state[0], "the mark of a clamped wall passes"


def test_compensation_is_off_by_default_and_recorded_when_on(rig_hit: Hits, free: Any) -> None:
    experiment = config.override(
        config.with_realtime(presets.load("koul-rigid")), {"trial.duration_s": 0.3, "verdict.tail_s": 0.1}
    )
    wanted = Compensation(up=0.02, down=0.018, dead_band=0.3)
    recordings = [rig_hit(experiment, law=law).recording for law in (None, compensate_friction(free, wanted))]
    assert experiment.wall.law == "spring-damper"
    named = [recording.header["initial_state"]["law"] for recording in recordings]
    assert [law["name"] for law in named] == ["spring-damper", "spring-damper+friction"]
    assert named[1]["parameters"][:4] == [0.02, 0.018, 0.3, 0.8]
    rows = recordings[1].rows
    trial = rows[(rows["phase"] == Phase.TRIAL) & (rows["penetration"] < 0) & (rows["velocity"] > 0.3)]
    assert trial["effort_wall"] == pytest.approx(-0.016), "outside the wall too, in the column of the law"


def test_a_replay_needs_only_the_wrapper(free: Any) -> None:
    wall = {"stiffness": 300.0, "damping": 0.5, "pull": "clamp", "damping_on": "both", "side": 1}
    law = compensate_friction(free, Compensation(up=0.03, down=0.01, dead_band=0.1)).prepare(wall)
    again = laws.get("spring-damper+friction")
    state = np.zeros_like(law.state)
    expected = law.law.function(1e-3, 0.05, 1, law.state, law.parameters)
    assert again.function(1e-3, 0.05, 1, state, law.parameters) == expected


@pytest.mark.parametrize("name", ["traced", "nudges", "excited+friction"])
def test_the_laws_of_an_identification_are_found_by_the_names_in_its_recordings(name: str) -> None:
    assert laws.get(name).name == name


def test_experiment_configures_compensation_by_a_share() -> None:
    helped = config.override(presets.load("chawda-linear"), {"controller.friction_compensation": 0.8})
    law = controller.for_experiment(helped, current_quantum_a=0.001).law
    assert law.law.name == "spring-damper+friction"
    quantum = helped.rig.encoder.resolution
    assert law.parameters[:4].tolist() == pytest.approx([0.19, 0.19, dead_band_of(quantum, 1000, 100.0), 0.8])


def test_on_two_masses_only_the_motor_sides_friction_is_taken_over() -> None:
    changes = {"controller.friction_compensation": 0.5, "controller.friction_dead_band": 0.2}
    law = controller.for_experiment(
        config.override(presets.load("koul-compliant"), changes), current_quantum_a=0.001
    ).law
    assert law.parameters[:4].tolist() == [0.005, 0.005, 0.2, 0.5]
