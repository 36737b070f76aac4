"""The firmware accepts every valid design of the law, and a parameter block transfers it completely."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from firmware_protocol.parameters import BY_NAME, LIVE, decode_block, encode_block
from rig import config
from rig.config import controller, device_law, presets
from rig.control import bilateral, laws
from rig.control.law import Law
from rig.core.errors import ConfigError, PlanError
from rig.experiments.trials.excitation_run import excited_law
from rig.experiments.trials.live import parameter_set
from tests.firmware.law.law_design import structure_of

PRESETS = {name: presets.load(name) for name in presets.names()}
QUANTUM = 0.001
VARIANTS = [
    ("fdm-butterworth-fixed", {}),
    ("fdm-butterworth-fixed", {"coefficient_bits": 30, "state_bits": 20, "cutoff_hz": 40.0}),
    (
        "fdm-butterworth-fixed",
        {"coefficient_bits": 20, "state_bits": 4, "word_bits": 16, "rounding": "floor"},
    ),
    ("fdm-butterworth-fixed", {"numerator": "nearest"}),
    ("fdm", {}),
    ("fdm-butterworth", {}),
    ("fdm-butterworth", {"order": 1}),
    ("fdm-butterworth", {"order": 5}),
    ("foaw-end", {"window_limit": 64.0, "band": 1e6}),
    ("foaw-best", {"anchor": "last", "stop": "global"}),
    ("levant", {"lipschitz": 1e5}),
    ("levant", {"discretisation": "explicit", "output": "u1"}),
    ("kalman", {"gain": "steady"}),
    ("kalman", {"gain": "steady", "model": "double"}),
]


@st.composite
def experiments(draw: st.DrawFn) -> config.Experiment:
    """Draw experiments with a law on the device; some are invalid."""
    estimator, parameters = draw(st.sampled_from(VARIANTS))
    velocity = draw(st.sampled_from([500, 1000, 2000, 5000]))
    side = draw(st.sampled_from([-1, 1]))
    base = PRESETS[draw(st.sampled_from(sorted(PRESETS)))]
    near = 0.1 * base.rig.limits.position_maximum
    wall = draw(st.sampled_from([-near, 0.0, near])) * draw(st.floats(1e-6, 1.0))
    changes = {
        "controller.loop": "device",
        "controller.estimator": estimator,
        "controller.parameters": parameters,
        "controller.velocity_rate": velocity,
        "controller.position_rate": velocity * draw(st.sampled_from([1, 2, 10])),
        "controller.prediction": draw(st.sampled_from(["hold", "hold", "extrapolate"])),
        "controller.arithmetic": draw(st.sampled_from(["auto", "auto", "fixed", "float32"])),
        "controller.slow_velocity_rate": draw(st.sampled_from([None, velocity // 5])),
        "controller.slow_below": draw(st.sampled_from([0.0, 0.05])),
        "controller.measured_current": draw(st.booleans()),
        "rig.encoder.sign": draw(st.sampled_from([-1, 1])),
        "wall.stiffness": base.wall.stiffness * draw(st.floats(1e-3, 1e3)),
        "wall.damping": draw(st.sampled_from([0.0, base.wall.damping * draw(st.floats(1e-3, 1e3))])),
        "wall.position": wall,
        "wall.side": side,
        "wall.pull": draw(st.sampled_from(["clamp", "allow"])),
        "wall.damping_on": draw(st.sampled_from(["both", "entry"])),
        "wall.law": draw(st.sampled_from(["spring-damper", "spring-damper", "bilateral"])),
        "trial.start": wall - side * near,
        "trial.effort": side * abs(base.trial.effort),
        "trial.minimum_rest_counts": 0.0,
        "trial.release_s": draw(st.sampled_from([1e-6, 0.1, 60.0])),
        "homing.damping": draw(st.sampled_from([0.0, base.homing.damping])),
        "homing.settle_s": draw(st.sampled_from([0.0, 0.1])),
    }
    return config.override(base, changes)


def values_of(x: config.Experiment, law: Law | None = None, reference: int = 12_345) -> dict:
    return controller.prepare_controller(
        x, current_quantum_a=QUANTUM, reference_count=reference, verified=True, law=law
    ).parameters


@given(experiments())
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_firmware_accepts_every_accepted_design(law: Any, x: Any) -> None:
    values, refusal = None, None
    try:
        values = values_of(x)
    except ConfigError as error:
        refusal = error
    if values is None:
        assert refusal is not None
        assert refusal.remedy
        return
    sense = x.rig.encoder.sign
    values = {name: value + 0 for name, value in values.items()}  # the wire has no minus zero
    struct = structure_of(values, sense)
    assert law.check(struct) == 0
    assert values["law"] == {"fixed": 1, "float32": 2}[device_law.arithmetic_of(x.controller)]
    carried = decode_block(encode_block(values))
    assert carried.keys() == values.keys()
    for name, value in values.items():
        exact = np.float32(value).item() if BY_NAME[name].ctype == "f32" else value
        assert carried[name] == exact, name
    assert bytes(structure_of(carried, sense)) == bytes(struct)


@given(experiments())
def test_a_block_has_one_wall_and_it_is_ours_again_in_si(x: Any) -> None:
    """A wall survives the conversion to the wire and back, up to the rounding of the device's words."""
    try:
        values = values_of(x)
    except ConfigError:
        return
    made = controller.for_experiment(x, current_quantum_a=QUANTUM, reference_count=12_345)
    c = made.control[0]
    delta, quantum, period_s = abs(c["resolution"]), c["effort_quantum"], c["tick_s"] * c["velocity_divider"]
    fixed = device_law.arithmetic_of(x.controller) == "fixed"
    assert not any(name.startswith("float_" if fixed else "fixed_") for name in values)
    wall = device_law.rendered_wall(decode_block(encode_block(values)), made)
    counts = 2.0**-9 if fixed else 2.0**-25
    in_counts = abs(x.wall.position) / delta
    assert abs(wall.position - x.wall.position) <= delta * (counts + 1e-14 * in_counts)
    if fixed:
        lsb = 0.5 * 2.0 ** -values["fixed_shift"]
        velocity_lsb = 2.0 ** -values["biquad_state_bits"]
        assert abs(wall.stiffness - x.wall.stiffness) <= lsb * 2**8 * quantum / delta * (1.0 + 1e-6)
        damping_lsb = lsb / velocity_lsb * quantum * period_s / delta
        assert abs(wall.damping - x.wall.damping) <= damping_lsb * (1.0 + 1e-6)
    else:
        assert wall.stiffness == pytest.approx(x.wall.stiffness, rel=2.0**-24 + 1e-14)
        assert wall.damping == pytest.approx(x.wall.damping, rel=2.0**-24 + 1e-14)


@given(experiments(), st.floats(0.05, 20.0), st.just(0.0) | st.floats(1e-6, 20.0), st.integers(-50, 50))
@settings(max_examples=10)
def test_a_live_wall_equals_one_from_the_beginning(x: Any, harder: float, damper: float, counts: int) -> None:
    """A wall that is set during a run has the same numbers as one set at its beginning."""
    moved = x.wall.position + counts * x.rig.encoder.resolution
    other = {"stiffness": x.wall.stiffness * harder, "damping": x.wall.damping * damper, "position": moved}
    there = replace(x, wall=replace(x.wall, **other))
    made = {"current_quantum_a": QUANTUM, "reference_count": 7}
    arithmetic = device_law.arithmetic_of(x.controller)
    try:
        whole = values_of(there, reference=7)
        values_of(x, reference=7)
    except ConfigError:
        return
    target = controller.for_experiment(there, **made)
    numbers = [float(target.control[0]["wall_position"]), *target.law.parameters.tolist()]
    live = device_law.live_parameters(controller.for_experiment(x, **made), arithmetic, numbers)
    assert live == {name: whole[name] for name in live}
    changed = {name for name in whole if whole[name] != values_of(x, reference=7)[name]}
    assert changed <= live.keys() <= LIVE


def test_a_set_of_the_mailbox_becomes_live_parameters() -> None:
    x = config.override(PRESETS["koul-rigid"], {"controller.loop": "device", "wall.stiffness": 200.0})
    made = {"current_quantum_a": QUANTUM, "reference_count": 0}
    numbers = parameter_set(x, **made)
    armed = controller.for_experiment(PRESETS["koul-rigid"], **made)
    live = device_law.live_parameters(armed, "float32", numbers)
    c = armed.control[0]
    assert live["float_stiffness"] == pytest.approx(200.0 * c["resolution"] / c["effort_quantum"])
    with pytest.raises(PlanError, match=r"wall.pull and wall.damping_on cannot change"):
        device_law.live_parameters(armed, "float32", [*numbers[:-1], 1.0])


FIXED = "fdm-butterworth-fixed"
REFUSED = [
    ({"estimator": "period"}, r'controller.estimator = "period".*does not have this estimator', "kalman"),
    ({"estimator": "optimal"}, r'controller.estimator = "optimal"', "foaw-best"),
    ({"estimator": "kalman"}, r'parameters.gain = "recursive"', 'gain = "steady"'),
    (
        {"estimator": "foaw-best", "parameters": {"anchor": "literal"}},
        r'parameters.anchor = "literal"',
        '"lsq"',
    ),
    ({"estimator": FIXED, "parameters": {"word_bits": 40}}, "parameters.word_bits = 40", "choose 32 or less"),
    ({"arithmetic": "fixed"}, "fdm-butterworth does not exist in integers", "fdm-butterworth-fixed"),
    (
        {"estimator": FIXED, "prediction": "extrapolate"},
        r'controller.prediction = "extrapolate"',
        '"float32"',
    ),
    ({"friction_compensation": 0.5}, "controller.friction_compensation", "friction_compensation to 0"),
]


@pytest.mark.parametrize(("changes", "message", "remedy"), REFUSED)
def test_unsupported_option_is_refused_with_key_and_remedy(changes: Any, message: str, remedy: str) -> None:
    given_ = {f"controller.{key}": value for key, value in {"loop": "device", **changes}.items()}
    x = config.override(PRESETS["koul-rigid"], given_)
    with pytest.raises(PlanError, match=message) as refused:
        values_of(x)
    assert remedy in refused.value.remedy
    assert 'controller.loop = "host"' in refused.value.remedy


def test_a_foreign_law_and_a_table_of_the_host_are_refused() -> None:
    x = config.override(PRESETS["koul-rigid"], {"controller.loop": "device"})
    foreign = Law("mine", "", laws.get("bilateral").function, 1, laws.get("bilateral").design)
    with pytest.raises(PlanError, match=r'wall.law = "mine".*does not have this law'):
        values_of(x, foreign)
    with pytest.raises(PlanError, match="the device cannot receive such a table"):
        values_of(x, bilateral.excited_law([0.1, -0.1]))


def test_values_beyond_the_wire_name_what_is_behind_them() -> None:
    x = config.override(
        PRESETS["chawda-linear"], {"controller.loop": "device", "homing.speed": 2.0, "rig.limits.speed": 3.0}
    )
    slow = config.override(x, {"controller.position_rate": 1000, "controller.velocity_rate": 1000})
    with pytest.raises(PlanError, match=r"homing.speed: home_step = .* is out of range for the device"):
        values_of(slow)
    with pytest.raises(PlanError, match="position_rate = 100000 Hz is out of range"):
        values_of(config.override(x, {"controller.position_rate": 100_000}))


def test_a_law_on_the_host_switches_the_one_on_the_device_off() -> None:
    values = values_of(PRESETS["koul-rigid"])
    assert values["law"] == 0
    assert "float_stiffness" not in values


@pytest.mark.parametrize("estimator", ["fdm-butterworth-fixed", "fdm-butterworth"])
@pytest.mark.parametrize("stiffness", [0.0, 1e-3, 1.0, 1e3])
def test_an_excitation_beside_a_wall_is_as_the_host_plays_it(
    law: Any, estimator: str, stiffness: float
) -> None:
    changes = {
        "controller.loop": "device",
        "controller.estimator": estimator,
        "wall.stiffness": 50.0 * stiffness,
        "wall.damping": 0.05 * stiffness,
        "excitation.channel": "motor",
        "excitation.period_s": 0.05,
        "excitation.low_hz": 20.0,
    }
    x = config.excited(config.override(PRESETS["koul-rigid"], {**changes, "trial.minimum_rest_counts": 0.0}))
    excitation = excited_law(x, 3, QUANTUM)
    struct = structure_of(values_of(x, excitation), 1)
    assert law.check(struct) == 0
    made = law.excitation(struct) * 2.0**-struct.excitation.bits * controller.effort_quantum(x, QUANTUM)
    prepared = excitation.prepare({"stiffness": 1.0, "damping": 0.0, "side": x.wall.side})
    np.testing.assert_array_equal(made, -x.wall.side * prepared.parameters[bilateral.TABLE :])


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_runs_on_a_device_in_float32(law: Any, name: Any) -> None:
    x = config.override(PRESETS[name], {"controller.loop": "device"})
    if x.controller.estimator == "kalman":
        x = config.override(x, {"controller.parameters.gain": "steady"})
    assert law.check(structure_of(values_of(x), x.rig.encoder.sign)) == 0
