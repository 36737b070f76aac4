"""Conversion of quantities to ticks, counts and quanta: the law and the device have the same limits."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig import config
from rig.config import controller, presets
from rig.control.law import Law
from rig.core.check import Outcome
from rig.core.errors import ConfigError, PlanError
from rig.devices.framed import FramedDevice
from rig.experiments.trials._device_limits import check_limits
from sim_backend.board.configuration import describe
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.link import MemoryLink

COMPLIANT = presets.load("koul-compliant")
ALL = presets.names()


def built(experiment: Any, **options: Any) -> Any:
    quantum = experiment.rig.amplifier.current_quantum_a
    return controller.for_experiment(experiment, current_quantum_a=quantum, **options)


def device_parameters(
    experiment: Any, *, reference_count: int = 0, verified: bool = True, **options: Any
) -> Any:
    quantum = options.pop("quantum", experiment.rig.amplifier.current_quantum_a)
    return controller.prepare_controller(
        experiment, current_quantum_a=quantum, reference_count=reference_count, verified=verified
    ).parameters


@pytest.mark.parametrize("realtime", [False, True])
@pytest.mark.parametrize("name", ALL)
def test_the_guard_and_the_device_clip_to_the_same_whole_number_of_quanta(name: Any, realtime: bool) -> None:
    experiment = presets.load(name)
    if realtime:
        experiment = config.with_realtime(experiment)
    control, values = built(experiment).control[0], device_parameters(experiment)
    quanta = control["effort_limit"] / control["effort_quantum"]
    assert quanta == pytest.approx(values["current_limit"], abs=1e-9)
    assert values["current_limit"] <= 32767
    assert control["effort_limit"] <= experiment.rig.limits.effort * (1 + 1e-9)
    assert experiment.rig.limits.effort - control["effort_limit"] < control["effort_quantum"] * (1 + 1e-9)


@pytest.mark.parametrize("name", ALL)
def test_every_preset_is_taken_by_its_simulated_device_as_it_is(name: Any) -> None:
    experiment = presets.load(name)
    with FramedDevice(MemoryLink(SimulatedDevice(config.rig_model(experiment)))) as device:
        values = device_parameters(experiment)
        echo = device.configure(values)
        device.arm()
        for parameter, value in values.items():
            assert echo.values[parameter] == pytest.approx(value, rel=1e-6), parameter
        assert echo.values["current_limit"] == values["current_limit"]


@given(
    quanta=st.integers(10, 32_000),
    per_ampere=st.floats(0.02, 2.0),
    quantum_a=st.sampled_from([1e-4, 1e-3, 3e-3]),
)
def test_an_effort_limit_of_a_whole_number_of_quanta_is_that_number(
    quanta: int, per_ampere: float, quantum_a: Any
) -> None:
    """Rounding must not lose a quantum: 3 N·m at 1 mN·m a quantum are 3000 quanta, not 2999."""
    effort = quanta * per_ampere * quantum_a
    limits = {
        "rig.limits.effort": effort,
        "rig.limits.nominal_effort": effort,
        "rig.amplifier.effort_limit": effort,
    }
    experiment = config.override(
        COMPLIANT,
        {
            "rig.amplifier.effort_per_ampere": per_ampere,
            "rig.amplifier.current_quantum_a": quantum_a,
            **limits,
            "trial.effort": effort / 2,
            "trial.minimum_rest_counts": 0,
            "homing.effort": effort / 2,
        },
    )
    assert controller.current_limit(experiment, quantum_a) == quanta
    assert (
        describe(config.rig_model(experiment), "x", 1000, 50000).parameter("current_limit").maximum == quanta
    )


def test_units_become_ticks_counts_and_quanta() -> None:
    experiment = config.override(
        COMPLIANT,
        {
            "controller.position_rate": 20_000,
            "controller.velocity_rate": 2_000,
            "rig.limits.speed": 10.0,
            "rig.limits.position_minimum": -0.05,
            "rig.limits.position_maximum": 0.04,
            "trial.duration_s": 0.5,
            "trial.release_s": 0.05,
            "homing.settle_s": 0.1,
            "homing.timeout_s": 2.0,
            "verdict.tail_s": 0.2,
        },
    )
    delta = experiment.rig.encoder.resolution
    quantum = experiment.rig.amplifier.effort_per_ampere * experiment.rig.amplifier.current_quantum_a
    c, p = built(experiment).control[0], device_parameters(experiment)
    assert c["tick_s"] == 1 / 20_000
    assert c["velocity_divider"] == 10
    assert (c["trial_ticks"], c["release_ticks"], c["settle_ticks"], c["home_timeout_ticks"]) == (
        10_000, 1_000, 2_000, 40_000,
    )  # fmt: skip
    assert c["resolution"] == delta
    assert c["effort_quantum"] == pytest.approx(quantum)
    assert c["home_tolerance"] == pytest.approx(experiment.homing.tolerance_counts * delta)
    assert c["home_step"] == pytest.approx(experiment.homing.speed / 20_000)
    assert c["trial_slew"] == pytest.approx(experiment.rig.limits.slew / 20_000)
    assert p["position_rate"] == 20_000
    assert p["speed_limit"] == math.ceil(10.0 / delta)
    assert p["window_minimum"] == round(-0.05 / delta)
    assert p["window_maximum"] == round(0.04 / delta)
    assert p["continuous_current"] == math.floor(experiment.rig.limits.nominal_effort / quantum)
    assert (p["motion"], device_parameters(presets.load("chawda-linear"))["motion"]) == (0, 1)
    assert (p["verified"], device_parameters(experiment, verified=False)["verified"]) == (1, 0)


def test_the_device_never_limits_what_the_guard_lets_through() -> None:
    """Rounding outwards or to nearest keeps the device's limits of slew, speed and window at least the host's."""
    for name in ALL:
        experiment = presets.load(name)
        c, p = built(experiment).control[0], device_parameters(experiment)
        assert p["slew_limit"] == 65_535 or p["slew_limit"] * c["effort_quantum"] >= c["trial_slew"]
        assert p["speed_limit"] * abs(c["resolution"]) >= c["speed_limit"]
        assert p["window_maximum"] * c["resolution"] >= c["window_maximum"] - abs(c["resolution"])


def test_an_encoder_that_counts_down_swaps_the_edges_of_the_window() -> None:
    """With falling counts, positions −0.05 … 0.04 are counts −0.04/δ … 0.05/δ from the reference."""
    window = {"rig.limits.position_minimum": -0.05, "rig.limits.position_maximum": 0.04}
    experiment = config.override(COMPLIANT, {**window, "rig.encoder.sign": -1})
    delta = experiment.rig.encoder.resolution
    values = device_parameters(experiment, reference_count=1000)
    assert values["window_minimum"] == 1000 - round(0.04 / delta)
    assert values["window_maximum"] == 1000 + round(0.05 / delta)
    assert values["reference_count"] == 1000
    assert built(experiment, reference_count=1000).control[0]["resolution"] == -delta
    assert built(experiment, reference_count=1000).control[0]["reference_count"] == 1000
    assert values["speed_limit"] > 0


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_edges_of_both_windows_are_the_same_place(sign: int) -> None:
    experiment = config.override(COMPLIANT, {"rig.encoder.sign": sign})
    c, p = built(experiment, reference_count=77).control[0], device_parameters(experiment, reference_count=77)
    edges = sorted(c["resolution"] * (p[name] - 77) for name in ("window_minimum", "window_maximum"))
    assert edges == pytest.approx([c["window_minimum"], c["window_maximum"]], abs=abs(c["resolution"]) / 2)


@pytest.mark.parametrize(
    ("rate", "configured", "expected"),
    [
        (20_000, None, 0.003),  # five ticks would be 250 µs: too short for any host
        (2_000, None, 0.003),
        (1_000, None, 0.005),
        (250, None, 0.020),
        (100, None, 0.020),  # two ticks: a device holds no command for longer
        (1_000, 0.012, 0.012),
    ],
)
def test_a_command_lives_five_ticks_and_3_ms(rate: int, configured: float | None, expected: float) -> None:
    changes = {
        "controller.position_rate": rate,
        "controller.velocity_rate": rate,
        "verdict.lowpass_hz": rate / 4,
    }
    if rate <= 250:
        changes |= {"controller.parameters.cutoff_hz": rate / 10, "verdict.highpass_hz": 5.0}
    if configured is not None:
        changes["controller.command_lifetime_s"] = configured
    experiment = config.override(COMPLIANT, changes)
    assert controller.command_lifetime_s(experiment) == pytest.approx(expected)
    assert device_parameters(experiment)["command_lifetime_us"] == round(expected * 1e6)


SLOW = {
    "controller.position_rate": 80,
    "controller.velocity_rate": 80,
    "verdict.lowpass_hz": 30.0,
    "verdict.highpass_hz": 5.0,
    "controller.parameters.cutoff_hz": 20.0,
}


@pytest.mark.parametrize(
    ("changes", "name", "words"),
    [
        (SLOW, "command_lifetime_us", "25000 µs is out of range for the device: allowed are 100 to 20000"),
        ({"rig.limits.speed": 1e9}, "speed_limit", "count/s"),
        ({"rig.limits.position_maximum": 1e7}, "window_maximum", "-2.14748e+09 to 2.14748e+09"),
        ({"rig.limits.thermal_time_constant_s": 0.1}, "thermal_time_constant", "0.125 to 8192"),
    ],
)
def test_a_value_out_of_range_of_the_wire_is_refused_by_name(changes: Any, name: str, words: str) -> None:
    experiment = config.override(COMPLIANT, changes)
    with pytest.raises(PlanError) as caught:
        device_parameters(experiment)
    assert str(caught.value).startswith(f"{name} = ")
    assert words in str(caught.value)
    assert caught.value.remedy
    assert isinstance(caught.value, ConfigError)


def test_a_quantum_too_fine_for_the_limit_is_refused() -> None:
    """The quantum comes from the device, not from the file."""
    with pytest.raises(PlanError, match=r"current_limit = .* quantum .* 0 to 32767"):
        device_parameters(COMPLIANT, quantum=1e-6)


def test_the_named_law_and_estimator_are_used_or_the_callers_law() -> None:
    made = built(COMPLIANT)
    assert made.law.law.name == COMPLIANT.wall.law
    assert made.estimator.estimator.name == COMPLIANT.controller.estimator
    assert made.law.parameters.tolist()[:2] == [COMPLIANT.wall.stiffness, COMPLIANT.wall.damping]
    mine = Law("mine", "for this test", made.law.law.function, 3, lambda wall: [wall["stiffness"] / 2])
    other = built(COMPLIANT, law=mine)
    assert other.law.law is mine
    assert other.law.parameters.tolist() == [COMPLIANT.wall.stiffness / 2]
    assert np.all(other.law.state == 0.0)


def test_each_controller_has_a_memory_of_its_own() -> None:
    first, second = built(COMPLIANT), built(COMPLIANT)
    first.memory["index"] = 5
    first.law.state[0] = 1.0
    assert second.memory["index"] == -1
    assert second.law.state[0] == 0.0


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("speed_limit", "rig.limits.speed"),
        ("current_limit", "rig.limits.effort"),
        ("continuous_current", "rig.limits.nominal_effort"),
        ("window_maximum", "rig.limits.position_minimum and position_maximum"),
    ],
)
def test_smaller_limits_of_a_device_are_found_before_it_refuses(name: str, key: str) -> None:
    quantum = COMPLIANT.rig.amplifier.current_quantum_a
    run = controller.prepare_controller(COMPLIANT, current_quantum_a=quantum)
    own = describe(config.rig_model(COMPLIANT), "a drive", 20_000, 20_000)
    assert check_limits(run, own).outcome is Outcome.OK
    half = int(run.parameters[name]) // 2
    narrow = tuple(replace(one, maximum=half) if one.name == name else one for one in own.parameters)
    found = check_limits(run, replace(own, parameters=narrow))
    assert found.outcome is Outcome.REFUSED
    assert found.text.startswith(f"{own.device} does not accept these limits: {name} ")
    assert key in found.remedy
    if name == "speed_limit":
        assert "10 rad/s (allowed: 0 to 5 rad/s)" in found.text
