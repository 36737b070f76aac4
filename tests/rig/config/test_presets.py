"""Presets, rigs of two papers and commercial ones: their files, default walls and homing servos."""

import tomllib
from importlib.resources import files

import pytest

from rig import config
from rig.config import experiment_from_mapping, presets, with_realtime
from rig.control.verdict import Kind
from rig.core.operators import NO_OPERATOR
from rig.doctor.late_loops import LateLoops
from rig.experiments.hits.hit_simulator import HitSimulator

OWNED = ("course-paddle", "hapkit", "moteus-knob", "smartknob", "woodenhaptics")


@pytest.mark.parametrize("name", presets.names())
def test_a_preset_ships_as_a_readable_file_that_is_its_text(name: str) -> None:
    text = presets.text(name)
    assert text == (files("rig.config.presets") / f"{name}.toml").read_text(encoding="utf-8")
    assert experiment_from_mapping(tomllib.loads(text), name) == presets.load(name)


RATINGS = {  # of Koul et al.'s motor, encoder and capstan, by their data sheets
    "amplifier": {"effort_per_ampere": 0.234, "effort_limit": 1.3, "back_emf_damping": 0.0253},
    "encoder": {"counts_per_revolution": 1000, "decoding": 4, "ratio": 10.0},
    "limits": {"nominal_effort": 0.286, "effort": 1.3, "thermal_time_constant_s": 12.0},
}


@pytest.mark.parametrize("name", ["koul-compliant", "koul-rigid"])
def test_a_papers_motor_is_protected_by_the_ratings_of_its_data_sheet(name: str) -> None:
    rig = config.as_mapping(presets.load(name))["rig"]
    assert {part: {key: rig[part][key] for key in known} for part, known in RATINGS.items()} == RATINGS


@pytest.mark.parametrize("late", [0, 1])
@pytest.mark.parametrize("name", presets.names())
def test_the_default_wall_of_a_preset_is_stable_and_feels_hard(name: str, late: int) -> None:
    """It stops the handle within millimetres but many counts, with effort to spare, and then rests."""
    x = config.override(presets.load(name), {"rig.simulation.computation_delay_ticks": late})
    x = with_realtime(x) if late else x
    found = HitSimulator(x).hit(x.wall.stiffness, x.wall.damping)
    for measured in (found.true, found.recorded):
        assert measured.kind is Kind.STABLE, measured.found
    depth, handle = x.trial.effort / x.wall.stiffness, x.rig.mechanics.handle_radius
    assert depth >= 3.0 * x.rig.encoder.resolution
    assert depth * handle <= 2.5e-3
    assert found.true.numbers["saturated_fraction"] <= 1e-3
    assert x.trial.effort > 2.0 * (x.rig.mechanics.motor_coulomb + x.rig.mechanics.link_coulomb)


@pytest.mark.parametrize("late", [0, 1])
@pytest.mark.parametrize("name", OWNED)
def test_the_default_wall_of_an_owned_rig_is_stable_in_a_hand(name: str, late: int) -> None:
    changes = {"trial.kind": "human", "rig.simulation.computation_delay_ticks": late}
    x = config.override(presets.load(name), changes)
    x = with_realtime(x) if late else x
    found = HitSimulator(x).hit(x.wall.stiffness, x.wall.damping)
    assert (found.true.kind, found.recorded.kind) == (Kind.STABLE, Kind.STABLE)


@pytest.mark.parametrize("name", presets.names())
def test_the_homing_servo_is_stable_and_friction_cannot_hold_the_handle_out_of_tolerance(name: str) -> None:
    experiment = presets.load(name)
    rig, homing = experiment.rig, experiment.homing
    assert LateLoops.of(experiment, 0).radius(homing.stiffness, homing.damping)[NO_OPERATOR] < 1.0
    friction = rig.mechanics.motor_coulomb + rig.mechanics.link_coulomb
    assert friction / homing.stiffness / rig.encoder.resolution < homing.tolerance_counts
    width = rig.limits.position_maximum - rig.limits.position_minimum
    assert width / homing.speed + homing.settle_s < homing.timeout_s
    assert friction < homing.effort


@pytest.mark.parametrize("name", presets.names())
def test_the_slew_limit_of_a_trial_lets_the_wall_reverse_the_effort_within_a_tick(name: str) -> None:
    experiment = presets.load(name)
    limits = experiment.rig.limits
    assert limits.slew / experiment.controller.position_rate >= 2 * limits.effort
