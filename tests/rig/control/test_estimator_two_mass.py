"""Disturbance observer of two masses: the plug-in of the ranking's page, its poles, and what it refuses."""

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig
from rig.analysis import theory
from rig.config import prepare_estimator
from rig.control import estimators
from rig.core.errors import ConfigError
from tests.conformance.guides import ROOT

NAME, RATE = "disturbance-two-mass", 20_000
PAGE = ROOT / "rig" / "docs" / "reference" / "ranking-entries.md"
HELD = {"trial.kind": "human", "operator.grip": "normal", "rig.limits.human": False}
MASSES = {"motor_inertia": 1.9e-4, "link_inertia": 1.58e-3, "transmission_stiffness": 2310.0}


@pytest.mark.exhaustive("::test_the_poles_of_its_velocity_are_those_of_the_design_for_a_high_rate")
def test_its_velocities_are_those_of_the_plug_in_that_was_ranked(tmp_path: Path) -> None:
    """The results on the page are those of the plug-in; both have the same steps in other units."""
    code, file = PAGE.read_text(encoding="utf-8").split("```python\n")[1], tmp_path / "entry.py"
    file.write_text(code.split("\nhit = ")[0], encoding="utf-8")
    plug_in = runpy.run_path(str(file))["two_mass"]
    random = np.random.default_rng(5)
    samples = estimators.inputs(np.cumsum(random.integers(-9, 10, 4000)), 1.0 / RATE)
    effort = random.normal(size=4000)
    theirs = plug_in.prepare({"frequency_hz": 215.0}, -1.5708e-4, 1.0 / RATE)
    expected, _ = estimators.run(theirs, *samples, effort)
    own = estimators.get(NAME).prepare({"frequency_hz": 215.0, **MASSES}, -1.5708e-4, 1.0 / RATE)
    found, _ = estimators.run(own, *samples, effort)
    assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()


def test_it_has_the_masses_of_its_rig_and_a_rigid_rig_or_a_low_rate_is_refused() -> None:
    held = rig.load("koul-compliant", changes={"controller.estimator": NAME, **HELD})
    expected = estimators.get(NAME).prepare(MASSES, 1e-4, 1.0 / RATE).parameters
    assert prepare_estimator(held, 1e-4, 1.0 / RATE).parameters == pytest.approx(expected, rel=1e-12)
    with pytest.raises(ConfigError, match="not two masses joined by a spring") as refused:
        rig.hit("koul-rigid", estimator=NAME)
    assert "choose the estimator disturbance" in refused.value.remedy


@pytest.mark.parametrize(("settings", "rate"), [({}, 2_000), ({"frequency_hz": 825.0}, 8_805), ({}, 1_000)])
def test_the_named_velocity_rate_is_the_lowest_stable_one(settings: Any, rate: int) -> None:
    """A bug named 15 times the mode's frequency, 8.8 kHz: more than needed at 150 Hz, unstable at 825 Hz."""
    named = r"unstable at a velocity rate of .* Hz .* mode of 587 Hz"
    with pytest.raises(ConfigError, match=named) as refused:
        estimators.get(NAME).prepare({**MASSES, **settings}, 1e-4, 1.0 / rate)
    assert ("lower frequency_hz" in refused.value.remedy) == (rate > 1850)
    least = int(refused.value.remedy.split()[3])
    estimators.get(NAME).prepare({**MASSES, **settings}, 1e-4, 1.0 / least)
    with pytest.raises(ConfigError, match=named):
        estimators.get(NAME).prepare({**MASSES, **settings}, 1e-4, 1.0 / (0.98 * least))


def test_the_poles_of_its_velocity_are_those_of_the_design_for_a_high_rate() -> None:
    found = theory.realise(NAME, {"frequency_hz": 150.0, **MASSES}, 1e-5, 1e-4)
    poles, mode = np.log(np.linalg.eigvals(found.a)) / 1e-5, np.sqrt(2310.0 / 1.9e-4 + 2310.0 / 1.58e-3)
    assert sorted(abs(poles)) == pytest.approx([*3 * [2.0 * np.pi * 150.0], *2 * [mode]], rel=0.08)
    assert found.of_effort is not None
    assert found.of_effort.impulse(1) == pytest.approx(1e-5 / 1.9e-4, rel=0.01)  # N·m at the motor's inertia
