"""The homing servo: it arrives within the limits of friction, and its default settings suit any rig."""

from typing import Any

import pytest

from rig.config import homing, override, presets
from rig.config._load import experiment_from_mapping, with_realtime
from rig.core.operators import NO_OPERATOR
from rig.doctor.late_loops import LateLoops

KOUL = presets.load("koul-rigid")
PHD: dict[str, Any] = {  # from two data sheets
    "preset": "koul-rigid",
    "rig": {
        "name": "phd",
        "mechanics": {
            "motor_inertia": 1.584e-3,
            "link_inertia": 3.84e-4,
            "motor_coulomb": 0.03,
            "end_mass": 0.0,
        },
        "amplifier": {
            "effort_per_ampere": 0.462,
            "effort_limit": 2.31,
            "lag_s": 1e-4,
            "set_point_delay_s": 2.5e-4,
        },
        "encoder": {"counts_per_revolution": 2048, "ratio": 12.0},
        "limits": {"nominal_effort": 1.155, "effort": 2.31},
    },
}


@pytest.mark.parametrize("name", presets.names())
def test_a_preset_has_the_tolerance_that_it_describes(name: str) -> None:
    x = presets.load(name)
    assert homing.home_tolerance(x) == x.homing.tolerance_counts * x.rig.encoder.resolution


def test_the_home_tolerance_covers_the_rest_within_friction() -> None:
    x = override(KOUL, {"rig.mechanics.motor_coulomb": 0.03, "rig.encoder.counts_per_revolution": 2048})
    assert homing.home_tolerance(x) == pytest.approx(1.25 * 0.03 / 20.0)
    assert homing.home_tolerance(override(x, {"homing.stiffness": 200.0})) == pytest.approx(
        8.0 * x.rig.encoder.resolution
    )


def test_an_effort_is_not_rounded_beyond_its_limit() -> None:
    limits = {"nominal_effort": 0.192619, "effort": 0.192619}
    rig = {"name": "weak", "limits": limits, "mechanics": {"motor_coulomb": 0.05}}
    x = experiment_from_mapping({"preset": "koul-rigid", "rig": rig}, "weak.toml")
    assert x.homing.effort == 0.192619


def test_a_rig_with_its_own_name_has_its_own_servo() -> None:
    x = experiment_from_mapping(PHD, "phd.toml")
    assert x.homing.stiffness > 2.0 * KOUL.homing.stiffness
    assert homing.resting_offset(x) < homing.usual_offset(x)
    slow = with_realtime(x)
    assert slow.homing.stiffness < x.homing.stiffness  # a slower loop
    assert homing.phase_margin(slow, slow.homing.stiffness, slow.homing.damping, 2) > 0.0
    given = experiment_from_mapping({**PHD, "homing": {"stiffness": 30.0}}, "phd.toml")
    assert given.homing.stiffness == with_realtime(given).homing.stiffness == 30.0
    renamed = {**PHD, "rig": {**PHD["rig"], "name": "koul-rigid"}}
    assert experiment_from_mapping(renamed, "phd.toml").homing == KOUL.homing


@pytest.mark.parametrize("name", presets.names())
@pytest.mark.parametrize("ticks", [0, 2])
def test_a_designed_servo_is_stable_by_linear_theory(name: str, ticks: int) -> None:
    x = presets.load(name)
    servo = homing.stable_servo(x)
    assert LateLoops.of(x, ticks).radius(servo.stiffness, servo.damping)[NO_OPERATOR] < 1.0
    assert homing.phase_margin(x, servo.stiffness, servo.damping, ticks) > 0.0
    person = override(
        x, {"trial.kind": "human", "rig.limits.override_stall": True, "trial.minimum_rest_counts": 1e-3}
    )
    servo = homing.stable_servo(person)
    assert max(LateLoops.of(person, ticks).radius(servo.stiffness, servo.damping).values()) < 1.0


@pytest.mark.parametrize("share", [0.3, 0.6, 2.0, 5.0, 20.0])
def test_the_margin_says_of_a_rigid_rig_what_the_spectral_radius_says(share: float) -> None:
    """Scale stiffness and damping of koul-rigid's servo by a share; shares near the limit are left out."""
    stiffness, damping = 20.0 * share**2, 0.2 * share
    radius = LateLoops.of(KOUL, 1).radius(stiffness, damping)[NO_OPERATOR]
    assert (homing.phase_margin(KOUL, stiffness, damping, 1) > 0.0) == (radius < 1.0)
