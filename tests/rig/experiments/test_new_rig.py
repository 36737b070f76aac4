"""A rig from two data sheets: computed values, assumed values, and a first hit that works."""

import math
import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rig
from rig.config._load import as_mapping
from rig.config.controller import prepare_controller
from rig.control.verdict import Kind
from rig.core.errors import ConfigError, PlanError, RecordingError
from rig.core.sample import Phase
from rig.experiments import new_rig as making
from rig.experiments._data_sheets import check_answers, questions
from rig.experiments.trials.plan import make_plan, plan_of

LEVER: dict[str, Any] = {
    "mechanism": "lever", "torque_constant": 0.0385, "rotor_inertia": 1.1e-5, "nominal_current": 2.5,
    "encoder_lines": 2048, "transmission": 12.0, "handle_length": 0.08, "handle_mass": 0.06,
}  # fmt: skip
CARRIAGE: dict[str, Any] = {
    "mechanism": "carriage", "torque_constant": 0.05, "rotor_inertia": 2e-5, "nominal_current": 2.0,
    "encoder_lines": 500, "pulley_radius": 0.01, "carriage_mass": 0.3,
}  # fmt: skip
LINEAR_MOTOR: dict[str, Any] = {
    "mechanism": "linear-motor", "force_constant": 10.0, "nominal_current": 2.0, "encoder_resolution": 1e-6,
    "carriage_mass": 0.5,
}  # fmt: skip

COARSE_AND_LIGHT: dict[str, Any] = {  # whose harder pushes need a wall that shows a weaker one too few counts deep
    "mechanism": "lever", "nominal_current": 4.526, "torque_constant": 0.07628, "rotor_inertia": 9.366e-6,
    "encoder_lines": 90, "encoder_at": "lever", "transmission": 2.229, "handle_length": 0.03613, "handle_mass": 0.02227,
    "amplifier": "voltage-bridge", "winding_resistance": 4.57, "winding_inductance": 3.708e-4, "supply_voltage": 48.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("answers", "inertia", "per_ampere", "nominal", "resolution"),
    [
        (LEVER, 1.1e-5 * 144 + 0.06 * 0.08**2, 0.462, 2.5 * 0.462, 2 * math.pi / (4 * 2048 * 12)),
        (CARRIAGE, 2e-5 / 0.01**2 + 0.3, 0.05 / 0.01, 10.0, 2 * math.pi * 0.01 / (4 * 500)),
        (LINEAR_MOTOR, 0.5, 10.0, 20.0, 1e-6),
    ],
)
def test_values_are_at_the_hand(
    answers: dict[str, Any], inertia: float, per_ampere: float, nominal: float, resolution: float
) -> None:
    made = rig.new_rig(**answers).experiment.rig
    mechanics, amplifier = made.mechanics, made.amplifier
    assert mechanics.motor_inertia + mechanics.link_inertia == pytest.approx(inertia, rel=1e-5)
    assert amplifier.effort_per_ampere == pytest.approx(per_ampere, rel=1e-5)
    assert made.limits.nominal_effort == pytest.approx(nominal, rel=1e-5)
    assert made.encoder.resolution == pytest.approx(resolution, rel=1e-5)
    assert mechanics.motor_coulomb == pytest.approx(0.05 * nominal, rel=1e-2)  # assumed


@pytest.mark.parametrize(
    ("more", "peak_a"),
    [
        ({}, 5.0),  # assumed: twice the nominal current
        ({"peak_current": 4.0}, 4.0),
        ({"peak_current": 4.0, "winding_resistance": 8.0, "supply_voltage": 24.0}, 3.0),  # stall
        ({"peak_current": 2.0}, 2.0),  # below the nominal current, which it limits too
        ({"amplifier": "voltage-bridge", "winding_resistance": 4.0, "supply_voltage": 24.0}, 6.0),
    ],
)
def test_amplifier_or_winding_limits_the_peak(more: dict[str, Any], peak_a: float) -> None:
    draft = making._Draft("mine")
    making._describe(draft, check_answers({**LEVER, **more}))
    made = {key.removeprefix("rig."): value for key, (value, _) in draft.keys.items()}
    assert made["limits.effort"] == made["amplifier.effort_limit"] == pytest.approx(0.462 * peak_a)
    assert made["limits.nominal_effort"] == pytest.approx(0.462 * min(peak_a, 2.5))
    if made["amplifier.drive"] == "voltage":
        assert made["amplifier.back_emf_damping"] == pytest.approx(0.462**2 / 4.0, rel=1e-5)
        assert not made["amplifier.current_monitor"]


def test_every_number_of_the_file_has_its_source_and_assumptions_are_listed(tmp_path: Path) -> None:
    path = tmp_path / "paddle.toml"
    made = rig.new_rig(path, **LEVER, amplifier="escon-50-5-pwm")
    text = path.read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if " = " in line]
    tag = re.compile(r" # ([^:]+: )?\[(data sheet|computed|assumed|chosen)\]")
    assert text == made.text
    assert len(lines) > 40
    assert all(tag.search(line) for line in lines), text
    assert made.experiment.rig.name == "paddle"
    assert made.experiment.rig.amplifier.set_point_delay_s == 2.5e-4
    assert as_mapping(rig.load(path)) == as_mapping(made.experiment)
    assumed = {one.key for one in made.assumed}
    assert {"rig.mechanics.motor_coulomb", "rig.limits.thermal_time_constant_s"} <= assumed
    assert text.count("[assumed]") == len(assumed) + 1  # and the legend
    known = rig.new_rig(**LEVER, friction=0.5, thermal_time_constant=20.0, travel=0.04)
    assert known.experiment.rig.mechanics.motor_coulomb == pytest.approx(0.5 * 0.08)
    assert known.experiment.rig.limits.position_maximum == pytest.approx(0.25)
    still = {one.key for one in known.assumed}
    assert not still & {"rig.mechanics.motor_coulomb", "rig.limits.position_maximum"}


def test_a_file_is_not_replaced_unless_asked(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("# mine\n")
    with pytest.raises(RecordingError):
        rig.new_rig(path, **LEVER)
    assert path.read_text() == "# mine\n"
    rig.new_rig(path, overwrite=True, **LEVER)
    assert rig.load(path).rig.name == "mine"


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ({"mechanism": "lever"}, r"(?s)missing for a lever.*`torque_constant`.*`handle_mass`"),
        ({}, "`mechanism` is missing"),
        ({**LEVER, "pulley_radius": 0.01}, "`pulley_radius` cannot be given for a lever"),
        ({**LEVER, "rotor_inertia": 110.0}, "rotor_inertia = 110 kg·m² is out of range.*g·cm²"),
        ({**LEVER, "encoder_lines": 2048.5}, "encoder_lines"),
        ({**LEVER, "amplifier": "escon"}, "escon.*known"),
        ({**LEVER, "amplifier": "escon-50-5-pwm", "peak_current": 20.0}, "above the maximum of escon-50-5"),
        ({**LEVER, "amplifier": "voltage-bridge"}, "winding_resistance and supply_voltage"),
        ({**LEVER, "gear": 3.0}, "unknown data-sheet value 'gear'"),
    ],
)
def test_an_impossible_answer_is_refused_with_the_allowed_ones(answers: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as refused:
        rig.new_rig(**answers)
    assert refused.value.remedy


@pytest.mark.exhaustive("::test_a_motor_that_friction_holds_is_refused")
def test_assumed_friction_that_holds_the_carriage_is_refused_with_the_value_to_measure() -> None:
    strong = {
        "mechanism": "linear-motor", "nominal_current": 9.12, "force_constant": 13.6, "encoder_resolution": 2.66e-7,
        "carriage_mass": 0.0534,
    }  # fmt: skip
    with pytest.raises(PlanError, match=r"reduce the friction, 6.2 N; .* give the measured `friction`"):
        rig.new_rig(**strong)
    assert make_plan(rig.new_rig(**strong, friction=1.0).experiment).ok


def test_a_motor_that_friction_holds_is_refused() -> None:
    with pytest.raises(PlanError, match="friction") as refused:
        rig.new_rig(**LEVER, friction=20.0)
    assert "larger motor" in refused.value.remedy


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("torque_constant", "38.5 mN·m/A", 0.0385),
        ("torque_constant", "38.5mNm/A", 0.0385),
        ("torque_constant", "0.0385", 0.0385),
        ("rotor_inertia", "110 g·cm²", 1.1e-5),
        ("rotor_inertia", "110gcm^2", 1.1e-5),
        ("winding_inductance", "238 µH", 2.38e-4),
        ("winding_resistance", "2.18 Ω", 2.18),
        ("handle_length", "8cm", 0.08),
        ("encoder_lines", "2048", 2048),
        ("board", " none ", "none"),
    ],
)
def test_numbers_have_the_units_of_data_sheets(name: str, text: str, value: Any) -> None:
    assert questions()[name].read(name, text) == value


@pytest.mark.parametrize("text", ["", "12 V", "12 cm", "twelve", "1.5e999", "nan", "-3", "0"])
def test_a_text_that_is_no_torque_constant_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="torque_constant"):
        questions()["torque_constant"].read("torque_constant", text)


def log(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(math.log(low), math.log(high)).map(math.exp)


COMMON = {
    "nominal_current": log(0.3, 6.0),
    "board": st.sampled_from(["rp2040", "none"]),
    "amplifier": st.sampled_from(["generic", "escon-50-5-pwm", "escon-50-5-dac"]),
}
ROTARY_MOTOR = {
    "torque_constant": log(0.005, 0.1),
    "rotor_inertia": log(3e-7, 3e-5),
    "encoder_lines": st.sampled_from([90, 360, 1000, 4096]),  # 90: 360 counts
}
SHEETS = st.one_of(
    st.fixed_dictionaries(
        {
            "mechanism": st.just("lever"), "transmission": log(1.0, 20.0), "handle_length": log(0.03, 0.25),
            "handle_mass": log(0.01, 0.2), "encoder_at": st.sampled_from(["motor", "lever"]), **ROTARY_MOTOR, **COMMON,
        }
    ),
    st.fixed_dictionaries(
        {
            "mechanism": st.just("carriage"), "pulley_radius": log(0.005, 0.03), "carriage_mass": log(0.05, 1.0),
            **ROTARY_MOTOR, **COMMON,
        }
    ),
    st.fixed_dictionaries(
        {
            "mechanism": st.just("linear-motor"), "force_constant": log(2.0, 30.0),
            "encoder_resolution": log(5e-7, 2e-5), "carriage_mass": log(0.1, 2.0), **COMMON,
        }
    ),
)  # fmt: skip


def test_the_first_hit_of_a_coarse_and_light_rig_is_planned_and_reaches_its_wall(tmp_path: Path) -> None:
    check_first_hit(COARSE_AND_LIGHT, tmp_path)


@pytest.mark.exhaustive("::test_the_first_hit_of_a_coarse_and_light_rig_is_planned_and_reaches_its_wall")
@settings(max_examples=5)
@given(SHEETS)
def test_the_first_hit_of_any_rig_is_planned_and_reaches_its_wall(answers: dict[str, Any]) -> None:
    with TemporaryDirectory() as directory:
        check_first_hit(answers, Path(directory))


def check_first_hit(answers: dict[str, Any], directory: Path) -> None:
    made = rig.new_rig(directory / "own.toml", **answers)
    x = rig.load(directory / "own.toml")
    behind_a_port = plan_of(prepare_controller(rig.config.with_realtime(x)), linked=True)
    assert make_plan(x).ok, made.text
    assert behind_a_port.ok, made.text
    result = rig.hit(x, output=directory)
    rows = result.recording.rows
    assert (rows["position"][rows["phase"] == Phase.TRIAL] > x.wall.position).any(), made.text
    assert result.verdict.kind in (Kind.STABLE, Kind.LIMIT_CYCLE), made.text
