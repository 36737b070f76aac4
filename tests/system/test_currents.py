"""A lost motor lead, a dead or reversed amplifier, a sensor of another scale: never a stable wall."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.control.current import CURRENT
from rig.control.verdict import Kind
from rig.core.board import over_current
from rig.core.errors import DeviceFaultError, GuardError, RigError
from rig.core.sample import Phase, RowFlag
from rig.devices.fault_script import Faults, Happening
from rig.devices.framed import FramedDevice
from rig.experiments.trials.judgement import judge
from rig.recording.reader import open_recording
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.struck import InMemory, StruckTrial
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import trial_on

START = -0.015
RATE = 5_000  # Hz: a tick of the readable device is a tenth of a millisecond of Python
BASE = config.override(
    presets.load("koul-compliant"),
    {
        "controller.position_rate": RATE,
        "controller.velocity_rate": 1_000,
        "trial.duration_s": 0.2,
        "verdict.tail_s": 0.08,
    },
)
PERSON = {"trial.kind": "human", "homing.settle_s": 0.05}
QUANTUM_A = BASE.rig.amplifier.current_quantum_a
AT_REST = RATE // 4  # tick: in the wall, where a steady push holds it
PUSHED = (
    7 * RATE // 50
)  # tick: on its way there; a voltage-driven motor soon rests in the wall without a current


def hardware(**values: float) -> Callable[[Any], None]:
    def act(device: Any) -> None:
        for name, value in values.items():
            setattr(device.hardware, name, value)

    return act


def trial(
    directory: Path, make: Any, loop: str, *happenings: tuple[int, Callable[[Any], None]], **changes: Any
) -> tuple[Any, Any, RigError | None]:
    """The device, the recording, and what ended it."""
    directory.mkdir(exist_ok=True)
    experiment = config.override(BASE, {"controller.loop": loop, **changes})
    device = make(config.rig_model(experiment), initial_position=START)
    end = InMemory(device, Faults(device=tuple(Happening(*one) for one in happenings)), rest_s=0.1)
    ran = StruckTrial(end, directory, experiment)
    end.link.elapse(0.1)
    return device, ran.recording, ran.error


SIDES = pytest.mark.parametrize(
    ("make", "loop"), [(SimulatedDevice, "host"), (FirmwareDevice, "host"), (FirmwareDevice, "device")]
)
BROKEN = {
    "a lead that came off": {"drive": 0.0},
    "a dead amplifier": {"drive": 0.0, "gain": 0.0},
    "a dead sensor": {"gain": 0.0},
    "a reversed sensor": {"gain": -1.0},
    "a sensor of half the scale": {"gain": 0.5},
    "an amplifier of 1.25 times the scale": {"drive": 1.25},
}


DRIVES = pytest.mark.parametrize("drive", first_by_default(["voltage", "current"]))


@SIDES
@DRIVES
def test_the_current_of_a_sound_motor_follows(drive: str, make: Any, loop: str, tmp_path: Path) -> None:
    _, recording, error = trial(tmp_path, make, loop, **{"rig.amplifier.drive": drive})
    assert error is None
    flags = recording.rows["flags"]
    assert not (flags & (RowFlag.CURRENT_DIFFERS | RowFlag.OTHER_CURRENT)).any()
    judged = judge(recording, config.override(BASE, {"controller.loop": loop})).verdict
    assert judged.current_observed >= 10  # of 20 windows
    assert judged.kind is not Kind.INVALID, judged.reasons


@SIDES
def test_an_excited_voltage_driven_motor_raises_no_flag(make: Any, loop: str, tmp_path: Path) -> None:
    """To and fro every 10 ms, into the wall and out of it; a sixth of its current is back-EMF."""
    each = RATE // 100
    pushes = [
        (tick, hardware(external_effort=(-1.0) ** (tick // each)))
        for tick in range(PUSHED, 2 * RATE // 5, each)
    ]
    free = {"oscillations": 0, "energy": None, "position_minimum": -3.0, "position_maximum": 3.0}
    changes = {f"rig.limits.{name}": value for name, value in free.items()}
    _, recording, error = trial(
        tmp_path, make, loop, *pushes, **changes, **{"rig.amplifier.drive": "voltage"}
    )
    assert error is None
    rows = recording.rows
    assert np.abs(rows["velocity"]).max() > 4.0
    assert not (rows["flags"] & RowFlag.CURRENT_DIFFERS).any()
    assert np.count_nonzero(rows["flags"] & RowFlag.CURRENT_FOLLOWS) > 20


# 1 kHz is where a part of a tick is the whole of it for the simulation.
@pytest.mark.parametrize(
    ("make", "loop"), [(SimulatedDevice, "host"), (FirmwareDevice, "host"), (FirmwareDevice, "device")]
)
@pytest.mark.parametrize(
    ("rate", "delay_s"),
    first_by_default([(4_000, 3e-4), (1_000, 1e-4), (1_000, 1e-3), (10_000, 2.5e-4), (10_000, 3e-5)]),
)
def test_a_set_point_that_is_late_is_expected_late_at_every_rate(
    rate: int, delay_s: float, make: Any, loop: str, tmp_path: Path
) -> None:
    changes = {
        "controller.position_rate": rate,
        "rig.amplifier.set_point_delay_s": delay_s,
        "wall.stiffness": 20.0,
        "wall.damping": 0.05,
    }
    _, recording, error = trial(tmp_path, make, loop, **changes)
    assert error is None
    proper = recording.rows["flags"][recording.rows["phase"] == Phase.TRIAL]
    assert not (proper & RowFlag.CURRENT_DIFFERS).any()
    assert np.count_nonzero(proper & RowFlag.CURRENT_FOLLOWS) >= 10  # of 20 windows


# Each drive and each loop once on the firmware: the device compares in any case.
@pytest.mark.parametrize(
    ("make", "loop", "drive"),
    first_by_default(
        [
            (FirmwareDevice, "host", "voltage"),
            (FirmwareDevice, "device", "current"),
            (SimulatedDevice, "host", "current"),
            (SimulatedDevice, "host", "voltage"),
        ],
        2,
    ),
)
@pytest.mark.parametrize("name", BROKEN)
def test_a_current_that_is_not_the_one_that_was_set_ends_the_trial(
    name: str, make: Any, loop: str, drive: str, tmp_path: Path
) -> None:
    tick = PUSHED if drive == "voltage" else AT_REST
    broken = (tick, hardware(**BROKEN[name]))
    device, recording, error = trial(tmp_path, make, loop, broken, **{"rig.amplifier.drive": drive})
    assert isinstance(error, DeviceFaultError), error
    assert Fault.CURRENT_MISMATCH.text in error.message
    assert error.remedy
    assert device.current == 0
    rows = recording.rows
    seconds = (rows["sample_index"][-1] - rows["sample_index"][0]) / BASE.controller.position_rate
    assert seconds < tick / BASE.controller.position_rate + 0.02 + 0.01  # two windows; when homing began
    judged = judge(recording, config.override(BASE, {"controller.loop": loop})).verdict
    assert judged.kind is Kind.INVALID


def silent(device: Any) -> None:
    device._safety.currents[CURRENT.noise] = 2**32 - 1


@pytest.mark.parametrize("name", first_by_default(BROKEN, 2))
def test_the_host_detects_a_wrong_current_without_the_device(name: str, tmp_path: Path) -> None:
    device, recording, error = trial(
        tmp_path, SimulatedDevice, "host", (AT_REST, silent), (AT_REST, hardware(**BROKEN[name]))
    )
    assert isinstance(error, GuardError), error
    assert "measured current" in error.message
    assert device.current == 0
    assert recording.rows["current_sent"][-1] == 0
    judged = judge(recording, BASE).verdict
    assert judged.kind is Kind.INVALID
    assert "measured current" in judged.reasons[0]


def test_a_current_too_small_beside_the_noise_is_not_observed_and_no_agreement(tmp_path: Path) -> None:
    noisy = {"rig.amplifier.current_noise_a": 1.0}
    _, recording, error = trial(tmp_path, SimulatedDevice, "host", (10, hardware(gain=0.0)), **noisy)
    assert error is None
    experiment = config.override(BASE, noisy)
    judgement = judge(recording, experiment)
    assert judgement.verdict.current_observed == 0
    assert any(
        row.label == "motor current" and "not checked" in str(row.value) for row in judgement.rows(experiment)
    )


@pytest.mark.parametrize("spikes", [1, 2])
def test_one_spike_of_the_converter_is_no_over_current_and_two_are(spikes: int, tmp_path: Path) -> None:
    over = over_current(config.rig_model(BASE)) + 1
    _, recording, error = trial(
        tmp_path,
        SimulatedDevice,
        "host",
        (AT_REST, hardware(leak=2 * over)),  # whatever the motor's own current adds to it
        (AT_REST + spikes, hardware(leak=0)),
    )
    assert (np.abs(recording.rows["current_measured"]) >= over * QUANTUM_A).sum() == spikes
    if spikes == 1:
        assert error is None
    else:
        assert isinstance(error, DeviceFaultError)
        assert Fault.OVER_CURRENT.text in error.message


@SIDES
def test_the_zero_of_the_sensor_is_taken_off_while_the_amplifier_is_off(
    make: Any, loop: str, tmp_path: Path
) -> None:
    """A drifted zero of 60 quanta would be a mismatch in every window at rest."""
    experiment = config.override(BASE, {"controller.loop": loop})
    device = make(config.rig_model(experiment), initial_position=START)
    link = MemoryLink(device, Faults())
    device.hardware.leak = 60
    link.elapse(1.0)
    with FramedDevice(link) as framed:
        trial_on(framed, experiment, tmp_path / "trial.rigcap", sealed=False)
    rows = open_recording(tmp_path / "trial.rigcap").rows
    quantum = experiment.rig.amplifier.current_quantum_a
    still = rows["current_applied"] == 0
    still[1:] &= still[:-1]
    still[:40] = False
    assert not (rows["flags"] & RowFlag.CURRENT_DIFFERS).any()
    assert np.abs(rows["current_measured"][still]).max(initial=0.0) <= 2 * quantum


def test_a_device_that_applies_another_current_than_the_commanded_one_is_detected(tmp_path: Path) -> None:
    class Liar(SimulatedDevice):
        lies = False

        def tick(self) -> bytes:
            if self.lies and self.connection.state is State.RUNNING:
                self.board.rules[0] += 7  # of what the command wants
            return super().tick()

    def lie(device: Any) -> None:
        device.lies = True

    _, recording, _ = trial(tmp_path, Liar, "host", (AT_REST, lie))
    assert (recording.rows["flags"] & RowFlag.OTHER_CURRENT).sum() > 100
    judged = judge(recording, BASE).verdict
    assert judged.kind is Kind.INVALID
    assert "and the set current from the commanded one" in judged.reasons[0]
