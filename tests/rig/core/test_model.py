"""The typed model of a rig: derived values and continuous matrices against independent formulas."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from rig.core.model import Amplifier, Encoder, Mechanics, state_space
from tests.sim_backend.test_plant import ROTARY

COMPLIANT = ROTARY.mechanics
RIGID = replace(COMPLIANT, structure="rigid")
AMPLIFIER = Amplifier(effort_per_ampere=0.234, effort_limit=1.3, lag_s=1e-4)


def impedance(mechanics: Mechanics, s: complex) -> np.ndarray:
    """Return Z of (effort on motor, effort on link) = Z (motor velocity, link velocity), by Newton's law."""
    capstan = mechanics.transmission_stiffness / s + mechanics.transmission_damping
    motor = mechanics.motor_inertia * s + mechanics.motor_damping + capstan
    link = mechanics.loaded_link_inertia * s + mechanics.link_damping + capstan
    return np.array([[motor, -capstan], [-capstan, link]])


def transfer(mechanics: Mechanics, amplifier: Amplifier, *, state: int, source: int, omega: float) -> complex:
    """Return the response of one state to one input: an element of (jω − A)⁻¹ B."""
    model = state_space(mechanics, amplifier)
    response = np.linalg.solve(1j * omega * np.eye(model.order) - model.a, model.b[:, source])
    return complex(response[state])


@pytest.mark.parametrize("end_mass", [0.0, 0.07])
@pytest.mark.parametrize("frequency_hz", [3.0, 586.0, 2000.0])
def test_two_mass_matrices_are_newtons_law(frequency_hz: float, end_mass: float) -> None:
    mechanics = replace(COMPLIANT, end_mass=end_mass)
    s = 2j * math.pi * frequency_hz
    admittance = np.linalg.inv(impedance(mechanics, s))
    lag = 1.0 / (1.0 + s * AMPLIFIER.lag_s)
    for state, row in ((1, 0), (3, 1)):
        for source, wanted in ((0, lag * admittance[row, 0]), (1, admittance[row, 1])):
            got = transfer(mechanics, AMPLIFIER, state=state, source=source, omega=s.imag)
            assert got == pytest.approx(wanted, rel=1e-9)
        for source, mass in ((2, 0), (3, 1)):  # friction acts on its own mass, without lag
            got = transfer(mechanics, AMPLIFIER, state=state, source=source, omega=s.imag)
            assert got == pytest.approx(admittance[row, mass], rel=1e-9)


def test_rigid_matrices_are_one_inertia_with_the_friction_of_both_sides() -> None:
    model = state_space(RIGID, AMPLIFIER)
    s = 2j * math.pi * 40.0
    inertia, damping = 1.9e-4 + 1.58e-3, 3.7e-3
    wanted = 1.0 / (inertia * s + damping)
    assert transfer(RIGID, AMPLIFIER, state=1, source=1, omega=s.imag) == pytest.approx(wanted)
    lagged = wanted / (1.0 + s * 1e-4)
    assert transfer(RIGID, AMPLIFIER, state=1, source=0, omega=s.imag) == pytest.approx(lagged)
    assert list(model.friction) == pytest.approx([0.0067])


def test_koul_compliant_has_its_free_free_mode_at_586_hz_with_the_declared_damping_ratio() -> None:
    free = replace(COMPLIANT, motor_damping=0.0, link_damping=0.0)
    modes = np.linalg.eigvals(state_space(free, AMPLIFIER).a)
    mode = modes[np.argmax(modes.imag)]
    assert abs(mode) / (2 * math.pi) == pytest.approx(586.0, rel=3e-3)
    assert -mode.real / abs(mode) == pytest.approx(0.035, rel=1e-9)


@pytest.mark.parametrize("mechanics", [RIGID, COMPLIANT])
def test_without_lag_the_command_drives_the_motor_and_the_effort_state_stands_alone(
    mechanics: Mechanics,
) -> None:
    model = state_space(mechanics, replace(AMPLIFIER, lag_s=0.0))
    assert not model.a[model.effort].any()
    assert not model.a[:, model.effort].any()
    assert not model.b[model.effort].any()
    velocity = 1
    assert model.b[velocity, 0] == model.b[velocity, 2]  # the command acts where the motor's friction acts


def test_a_voltage_driven_rig_is_the_dc_motor_of_its_data_sheet() -> None:
    """R, L and k_e of Koul's motor at the rotor, ratio 10: compare poles, and speed and current per volt."""
    resistance, inductance, k, ratio = 2.18, 0.238e-3, 0.0234, 10.0
    rotor, viscous = 1.77e-3 / ratio**2, 3.7e-3 / ratio**2
    motor = np.array(
        [
            [0.0, 1.0, 0.0],
            [0.0, -viscous / rotor, k / rotor],
            [0.0, -k / inductance, -resistance / inductance],
        ]
    )
    amplifier = replace(
        AMPLIFIER,
        drive="voltage",
        lag_s=inductance / resistance,
        back_emf_damping=k**2 / resistance * ratio**2,
    )
    model = state_space(RIGID, amplifier)
    wanted = np.sort_complex(np.linalg.eigvals(motor))
    assert np.sort_complex(np.linalg.eigvals(model.a)) == pytest.approx(wanted, rel=1e-9, abs=1e-9)
    for omega in (1.0, 1e3, 1e5):
        resolvent = np.linalg.inv(1j * omega * np.eye(3) - motor)
        per_volt = ratio * k / resistance  # command of a volt: its stalled current, as effort at the link
        speed = transfer(RIGID, amplifier, state=1, source=0, omega=omega) * per_volt
        current = transfer(RIGID, amplifier, state=2, source=0, omega=omega) * per_volt / (ratio * k)
        assert speed == pytest.approx(resolvent[1, 2] / inductance / ratio, rel=1e-9)
        assert current == pytest.approx(resolvent[2, 2] / inductance, rel=1e-9)


def test_back_emf_brakes_at_once_without_a_lag_and_never_under_current_drive() -> None:
    amplifier = replace(AMPLIFIER, back_emf_damping=0.0253, lag_s=0.0)
    for mechanics in (RIGID, COMPLIANT):
        current = state_space(mechanics, amplifier)
        voltage = state_space(mechanics, replace(amplifier, drive="voltage"))
        inertia = 1.9e-4 + (1.58e-3 if mechanics is RIGID else 0.0)
        assert voltage.a[1, 1] - current.a[1, 1] == pytest.approx(-0.0253 / inertia)
        assert (current.back_emf, voltage.back_emf) == (0.0, 0.0253)
    assert (state_space(RIGID, replace(amplifier, lag_s=1e-4)).a[2, :2] == 0.0).all()


def test_the_end_mass_loads_the_link_but_leaves_the_cable_as_it_is() -> None:
    loaded = replace(COMPLIANT, end_mass=0.07, gravity=-9.81)
    assert loaded.loaded_link_inertia == pytest.approx(1.58e-3 + 0.07 * 0.1**2)
    assert loaded.transmission_damping == COMPLIANT.transmission_damping
    assert loaded.gravity_effort == pytest.approx(-0.07 * 9.81 * 0.1)
    assert COMPLIANT.gravity_effort == 0.0


def test_encoder_resolution_of_koul_and_chawda() -> None:
    koul = Encoder(counts_per_revolution=1000, decoding=4, ratio=10.0)
    assert koul.resolution == pytest.approx(1.57e-4, rel=1e-3)
    assert replace(koul, decoding=1).resolution == pytest.approx(6.28e-4, rel=1e-3)
    assert Encoder(quantum=1e-6).resolution == 1e-6


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"counts_per_revolution": 1000, "quantum": 1e-6},
        {"counts_per_revolution": 0},
        {"quantum": 0.0},
        {"quantum": -1e-6},
        {"quantum": math.nan},
    ],
)
def test_an_encoder_without_exactly_one_size_above_zero_is_refused(given: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="counts_per_revolution or quantum"):
        Encoder(**given)
    with pytest.raises(ValidationError):
        TypeAdapter(Encoder).validate_json(json.dumps(given))


@pytest.mark.parametrize("missing", [{"transmission_stiffness": 0.0}, {"link_inertia": 0.0}])
def test_two_masses_need_a_capstan_and_a_link(missing: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="transmission_stiffness and link_inertia"):
        replace(COMPLIANT, **missing)
    assert replace(RIGID, **missing).structure == "rigid"


@pytest.mark.parametrize(
    ("key", "value"),
    [("motor_inertia", 0.0), ("gravity", 21.0), ("transmission_damping_ratio", 1.0), ("colour", "red")],
)
def test_a_description_out_of_range_or_with_an_unknown_key_is_refused(key: str, value: object) -> None:
    good = {"structure": "rigid", "motor_inertia": 1e-4, "link_inertia": 0.0}
    assert TypeAdapter(Mechanics).validate_json(json.dumps(good)).motor_inertia == 1e-4
    with pytest.raises(ValidationError, match=key):
        TypeAdapter(Mechanics).validate_json(json.dumps(good | {key: value}))
