"""Weighing with a known mass gives the true effort per ampere, whatever the friction, or is rejected."""

import io
from pathlib import Path
from typing import Any

import pytest

from rig import config, devices
from rig.analysis.identification._quality import IdentificationError
from rig.cli import run
from rig.cli.identify import _ask
from rig.config import presets
from rig.core.errors import ConfigError, PlanError
from rig.devices.framed import FramedDevice
from rig.experiments.motion._weigh import STANDARD_GRAVITY, Weighing, WeighRequest, weigh
from rig.recording.reader import open_recording
from tests.conformance.tiers import first_by_default

FAST = {"controller.position_rate": 2000, "controller.velocity_rate": 2000, "homing.speed": 0.5}
RIGID = config.override(presets.load("koul-rigid"), FAST)
MASS, ARM = 0.1, 0.08
WEIGHT = MASS * ARM * STANDARD_GRAVITY


def ask_no_person(text: str) -> None:
    pytest.fail(f"a simulated rig asks no person: {text}")


def weigh_rig(output: Path, **changes: Any) -> Weighing:
    wanted: dict[str, Any] = {"experiment": RIGID, "mass_kg": MASS, "arm_m": ARM, **changes}
    return weigh(WeighRequest(output=output, **wanted), ask_no_person)


@pytest.mark.parametrize("true", first_by_default([0.9, 1.15]))
def test_a_wrong_constant_is_measured(true: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The motor gives `true` times the described effort per ampere; a bent cable adds a constant effort."""

    opened = devices.open_device

    def open_device(*given: Any) -> FramedDevice:
        device = opened(*given)
        hardware = device.link.device.hardware  # type: ignore[attr-defined]
        hardware.drive, hardware.gain, hardware.external_effort = true, 1.0 / true, 0.015
        return device

    monkeypatch.setattr(devices, "open_device", open_device)
    found = weigh_rig(tmp_path)
    assert found.effort_per_ampere.value == pytest.approx(true * found.described, rel=2e-3)
    assert not found.agrees
    assert abs(found.bare.bias.value) == pytest.approx(0.015 / true, rel=0.02)


def test_a_person_hangs_the_mass_between_two_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = devices.open_device
    held: list[FramedDevice] = []
    asked: list[str] = []

    def open_device(url: str, *args: Any) -> FramedDevice:
        held.append(opened("sim://", *args))
        return held[-1]

    def hang(text: str) -> None:
        asked.append(text)
        held[0].link.device.hardware.external_effort = -WEIGHT  # type: ignore[attr-defined]

    monkeypatch.setattr(devices, "open_device", open_device)
    request = WeighRequest(experiment=RIGID, url="usb://1209:0001", output=tmp_path, mass_kg=MASS, arm_m=ARM)
    found = weigh(request, hang)
    assert found.weight == pytest.approx(WEIGHT)
    assert found.measured.holds(WEIGHT)
    assert found.agrees
    assert found.bare.coulomb.value == pytest.approx(RIGID.rig.mechanics.motor_coulomb, rel=0.01)
    assert [open_recording(path).rows["effort_sent"][-1] for path in found.recordings] == [0.0, 0.0]
    assert len(held) == 1
    (text,) = asked
    assert "hang 0.1 kg on it at 0.08 m" in text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass_kg": 0.5}, "rig.limits.nominal_effort"),
        ({"mass_kg": 0.31}, "a fifth of rig.limits.effort"),
        ({"mass_kg": 0.0}, "the mass is 0"),
        ({"arm_m": -1.0}, "the arm is -1"),
    ],
)
def test_a_load_beyond_the_motor_is_refused(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises((PlanError, ConfigError), match=message):
        weigh_rig(tmp_path, **changes)
    assert not list(tmp_path.iterdir())


def test_a_weight_that_friction_hides_is_no_calibration(tmp_path: Path) -> None:
    with pytest.raises(IdentificationError, match="cannot be distinguished from friction"):
        weigh_rig(tmp_path, mass_kg=1e-6)


def test_the_command_weighs_and_refuses_what_does_not_belong_to_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ["identify", "--rig", "koul-rigid", "--rate", "2k", "--set", "homing.speed=0.5"]
    weight = ["--weight", "0.1", "--recordings", str(tmp_path)]
    assert run([*command, *weight]) == 0
    assert "rig.amplifier.effort_per_ampere" in capsys.readouterr().out
    assert run([*command, "--arm", "0.1"]) == 2
    assert run([*command, *weight, "--plan"]) == 2
    capsys.readouterr()
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with pytest.raises(ConfigError, match="standard input ended before Enter"):
        _ask("hang it")
