"""Presets, rigs of two papers and commercial ones: their numbers and their default walls."""

import re
import tomllib
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from rig import config
from rig.config import as_mapping, experiment_from_mapping, presets, with_realtime
from rig.config._files import flatten
from rig.control.verdict import Kind
from rig.core.model import Mechanics, state_space
from rig.experiments.hits.hit_simulator import HitSimulator
from tests.sim_backend.test_plant import ROTARY

OF_PAPERS = ("chawda-linear", "koul-compliant", "koul-rigid")
OWNED = ("course-paddle", "hapkit", "moteus-knob", "smartknob", "woodenhaptics")
NAMES = tuple(sorted((*OF_PAPERS, *OWNED)))

KOUL_COMMON = {
    "rig.motion": "rotary",
    "rig.amplifier.effort_per_ampere": 0.234,  # 23.4 mN·m/A through the capstan
    "rig.amplifier.effort_limit": 1.3,
    "rig.amplifier.current_quantum_a": 0.001,
    "rig.amplifier.drive": "current",
    "rig.amplifier.back_emf_damping": 0.0253,
    "rig.encoder.counts_per_revolution": 1000,
    "rig.encoder.decoding": 4,
    "rig.encoder.ratio": 10.0,
    "rig.limits.nominal_effort": 0.286,
    "rig.limits.effort": 1.3,
    "rig.limits.thermal_time_constant_s": 12.0,
    "rig.limits.human": False,
    "controller.position_rate": 20000,
    "controller.velocity_rate": 2000,
    "controller.estimator": "fdm-butterworth",
    "controller.parameters": {"cutoff_hz": 200.0},
    "wall.stiffness": 300.0,
    "wall.damping": 0.5,
    "wall.position": 0.0,
    "wall.side": 1,
    "wall.pull": "clamp",
    "trial.effort": 0.15,
    "trial.start": -0.015,
    "trial.duration_s": 1.0,
    "verdict.felt_velocity": 0.005,
    "verdict.lowpass_hz": 500.0,
}
NUMBERS = {
    "koul-compliant": {**KOUL_COMMON, "rig.amplifier.lag_s": 1e-4},
    "koul-rigid": {**KOUL_COMMON, "rig.amplifier.lag_s": 1.09e-4},
    "chawda-linear": {
        "rig.motion": "linear",
        "rig.encoder.quantum": 1e-6,
        "controller.position_rate": 1000,
        "controller.velocity_rate": 1000,
        "wall.stiffness": 20000.0,
        "wall.damping": 60.0,
        "trial.effort": 8.0,
        "trial.start": -0.01,
        "verdict.felt_velocity": 0.002,
    },
}
VERDICT = {
    "tail_s": 0.4,
    "highpass_hz": 30.0,
    "heard_force": 1.0,
    "moved": 1.25e-4,
    "growth_ratio": 1.2,
    "late_fraction": 0.003,
    "saturated_fraction": 0.01,
}
MECHANICS = {
    "koul-compliant": replace(ROTARY.mechanics, end_mass=0.07),
    "koul-rigid": Mechanics(
        structure="rigid",
        motor_inertia=1.2e-4,
        link_inertia=2e-4,
        motor_damping=2e-3,
        link_damping=1e-3,
        motor_coulomb=0.02,
        handle_radius=0.1,
        end_mass=0.07,
    ),
    "chawda-linear": Mechanics(
        structure="rigid", motor_inertia=0.52, link_inertia=0.0, motor_damping=13.2, motor_coulomb=0.19
    ),
}


def test_the_presets_are_these() -> None:
    assert presets.names() == NAMES


@pytest.mark.parametrize("name", OF_PAPERS)
def test_numbers_are_those_of_the_reproduction_study(name: str) -> None:
    experiment = presets.load(name)
    assert experiment.rig.name == name
    assert experiment.rig.mechanics == MECHANICS[name]
    found = {
        **dict(flatten(as_mapping(experiment))),
        "controller.parameters": experiment.controller.parameters,
    }
    assert {
        key: found[key] if key in found else _default(experiment, key) for key in NUMBERS[name]
    } == NUMBERS[name]
    assert {key: getattr(experiment.verdict, key) for key in VERDICT} == VERDICT


def _default(experiment: object, key: str) -> object:
    for part in key.split("."):
        experiment = getattr(experiment, part)
    return experiment


@pytest.mark.parametrize("name", NAMES)
def test_a_preset_ships_as_a_readable_file_that_is_its_text(name: str) -> None:
    text = presets.text(name)
    assert text == (files("rig.config.presets") / f"{name}.toml").read_text(encoding="utf-8")
    assert experiment_from_mapping(tomllib.loads(text), name) == presets.load(name)


@pytest.mark.parametrize("name", OF_PAPERS)
def test_every_number_of_a_papers_rig_has_its_source(name: str) -> None:
    """Each non-zero value in [rig.*] has a comment; the file's head explains the tags in it."""
    text = presets.text(name)
    head, rest = text.split("[rig]", 1)
    physics = rest[rest.index("[rig.mechanics]") : rest.index("[controller]")]
    for line in physics.splitlines():
        if re.search(r"= *-?[\d.]*[1-9]", line):
            assert "#" in line, line
    for tag in set(re.findall(r"\[(Koul|maxon|fitted|typical|chosen|Chawda|declared)\]", rest)):
        assert f"[{tag}]" in head


@pytest.mark.parametrize("name", OWNED)
def test_every_number_of_an_owned_rig_has_a_source_or_is_assumed(name: str) -> None:
    """Each comment in [rig.*] begins with a tag that the file's head explains."""
    head, rest = presets.text(name).split("[rig]", 1)
    for line in rest[rest.index("[rig.mechanics]") : rest.index("[wall]")].splitlines():
        if re.search(r"= -?[\d.]*[1-9]", line) and not re.match(r"(velocity_rate|side)", line):
            tag = re.search(r"# \[(\w[\w-]*)\] ?", line)
            assert tag is not None, line
            assert f"[{tag[1]}]" in head, line
    assert "ASSUMED" in presets.load(name).rig.source
    assert "[assumed]" in rest


@pytest.mark.parametrize("late", [0, 1])
@pytest.mark.parametrize("name", NAMES)
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


@pytest.mark.parametrize("name", NAMES)
def test_the_homing_servo_is_stable_and_friction_cannot_hold_the_handle_out_of_tolerance(name: str) -> None:
    experiment = presets.load(name)
    rig, homing = experiment.rig, experiment.homing
    space = state_space(rig.mechanics, rig.amplifier)
    gain = np.zeros((1, space.order))
    gain[0, space.sensed_position], gain[0, space.sensed_position + 1] = homing.stiffness, homing.damping
    poles = np.linalg.eigvals(space.a - space.b[:, :1] @ gain)
    if rig.amplifier.lag_s == 0.0:  # the effort state is then not connected and stays where it is
        poles = np.delete(poles, np.argmin(np.abs(poles)))
    assert poles.real.max() < 0
    stuck = sum(space.friction) / homing.stiffness / rig.encoder.resolution
    assert stuck < homing.tolerance_counts
    width = rig.limits.position_maximum - rig.limits.position_minimum
    assert width / homing.speed + homing.settle_s < homing.timeout_s
    assert sum(space.friction) < homing.effort


@pytest.mark.parametrize("name", NAMES)
def test_the_slew_limit_of_a_trial_lets_the_wall_reverse_the_effort_within_a_tick(name: str) -> None:
    experiment = presets.load(name)
    limits = experiment.rig.limits
    assert limits.slew / experiment.controller.position_rate >= 2 * limits.effort


def test_in_real_time_the_chawda_rig_runs_as_it_is() -> None:
    experiment = presets.load("chawda-linear")
    assert with_realtime(experiment) == experiment
