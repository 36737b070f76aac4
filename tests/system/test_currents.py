"""A trial with a lost motor lead, a dead or reversed amplifier, or a sensor of another scale is never a stable wall."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.control.current import _UNOBSERVED, CURRENT, WINDOW_S
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
from sim_backend.board.safety import AT
from sim_backend.ends.link import MemoryLink
from tests.conformance.struck import InMemory, StruckTrial
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import trial_on

START = -0.015  # rad
RATE = 5_000  # Hz: `SimulatedDevice`, written in Python for reading, needs 0.1 ms per tick
DURATION_S = 0.2
WINDOWS = round(DURATION_S / WINDOW_S)  # comparisons of currents in a trial
BASE = config.override(
    presets.load("koul-compliant"),
    {
        "controller.position_rate": RATE,
        "controller.velocity_rate": 1_000,
        "trial.duration_s": DURATION_S,
        "verdict.tail_s": 0.08,
    },
)
QUANTUM_A = BASE.rig.amplifier.current_quantum_a
TICK_AT_REST = RATE // 4  # at 0.25 s a steady push holds the handle at rest in the wall
# At 0.14 s the handle approaches the wall: a voltage-driven motor soon rests in the wall without a current.
TICK_APPROACHING = 7 * RATE // 50

Action = Callable[[Any], None]  # changes the simulated device


def set_hardware(**values: float) -> Action:
    def act(device: Any) -> None:
        for name, value in values.items():
            setattr(device.hardware, name, value)

    return act


def run_trial(
    directory: Path, device_class: Any, loop: str, *actions: tuple[int, Action], **changes: Any
) -> tuple[Any, Any, RigError | None]:
    """Run a trial with actions at ticks of the device; return the device, the recording and the error that ended it."""
    directory.mkdir(exist_ok=True)
    experiment = config.override(BASE, {"controller.loop": loop, **changes})
    device = device_class(config.rig_model(experiment), initial_position=START)
    script = Faults(device=tuple(Happening(tick, action) for tick, action in actions))
    end = InMemory(device, script, rest_s=0.1)
    trial = StruckTrial(end, directory, experiment)
    end.link.elapse(0.1)
    return device, trial.recording, trial.error


SIDES = [(FirmwareDevice, "host"), (FirmwareDevice, "device"), (SimulatedDevice, "host")]
DEVICES_AND_LOOPS = pytest.mark.parametrize(("device_class", "loop"), first_by_default(SIDES, 2))
# Attributes of `Hardware`: `drive` is motor current / commanded current, `gain` is measured current / motor current.
BROKEN_HARDWARE = {
    "a lead that came off": {"drive": 0.0},
    "a dead amplifier": {"drive": 0.0, "gain": 0.0},
    "a dead sensor": {"gain": 0.0},
    "a reversed sensor": {"gain": -1.0},
    "a sensor of half the scale": {"gain": 0.5},
    "an amplifier of 1.25 times the scale": {"drive": 1.25},
}


@DEVICES_AND_LOOPS
@pytest.mark.parametrize("amplifier", first_by_default(["voltage", "current"]))
def test_the_current_of_a_motor_follows(amplifier: str, device_class: Any, loop: str, tmp_path: Path) -> None:
    _, recording, error = run_trial(tmp_path, device_class, loop, **{"rig.amplifier.drive": amplifier})
    assert error is None
    flags = recording.rows["flags"]
    assert not (flags & (RowFlag.CURRENT_DIFFERS | RowFlag.OTHER_CURRENT)).any()
    judged = judge(recording, config.override(BASE, {"controller.loop": loop})).verdict
    assert judged.current_observed >= WINDOWS // 2
    assert judged.kind is not Kind.INVALID, judged.reasons


@DEVICES_AND_LOOPS
def test_an_excited_voltage_driven_motor_raises_no_flag(device_class: Any, loop: str, tmp_path: Path) -> None:
    """An alternating push moves the handle across the wall every 10 ms; back-EMF is a sixth of the current."""
    alternation_ticks = RATE // 100
    pushes = [
        (tick, set_hardware(external_effort=(-1.0) ** (tick // alternation_ticks)))
        for tick in range(TICK_APPROACHING, 2 * RATE // 5, alternation_ticks)
    ]
    wide_limits = {"oscillations": 0, "energy": None, "position_minimum": -3.0, "position_maximum": 3.0}
    changes: dict[str, Any] = {f"rig.limits.{name}": value for name, value in wide_limits.items()}
    changes["rig.amplifier.drive"] = "voltage"
    _, recording, error = run_trial(tmp_path, device_class, loop, *pushes, **changes)
    assert error is None
    rows = recording.rows
    assert np.abs(rows["velocity"]).max() > 4.0
    assert not (rows["flags"] & RowFlag.CURRENT_DIFFERS).any()
    assert np.count_nonzero(rows["flags"] & RowFlag.CURRENT_FOLLOWS) > 20


# At 1 kHz the simulation rounds the delay of 0.1 ms up to a whole tick, 1 ms.
@DEVICES_AND_LOOPS
@pytest.mark.parametrize(
    ("rate", "delay_s"),
    first_by_default([(4_000, 3e-4), (1_000, 1e-4), (1_000, 1e-3), (10_000, 2.5e-4), (10_000, 3e-5)]),
)
def test_a_set_point_that_is_late_is_expected_late_at_every_rate(
    rate: int, delay_s: float, device_class: Any, loop: str, tmp_path: Path
) -> None:
    changes = {
        "controller.position_rate": rate,
        "rig.amplifier.set_point_delay_s": delay_s,
        "wall.stiffness": 20.0,
        "wall.damping": 0.05,
    }
    _, recording, error = run_trial(tmp_path, device_class, loop, **changes)
    assert error is None
    trial_flags = recording.rows["flags"][recording.rows["phase"] == Phase.TRIAL]
    assert not (trial_flags & RowFlag.CURRENT_DIFFERS).any()
    assert np.count_nonzero(trial_flags & RowFlag.CURRENT_FOLLOWS) >= WINDOWS // 2


# The firmware runs each amplifier type and each loop once, not all four combinations: it compares the currents in every
# tick, whichever side runs the loop. By default one case shows this for the law on the device.
@pytest.mark.parametrize(
    ("side", "amplifier", "name"),
    first_by_default(
        [
            (side, amplifier, name)
            for side, amplifier in zip((*SIDES, SIDES[2]), ("voltage", "current") * 2, strict=True)
            for name in BROKEN_HARDWARE
        ],
        len(BROKEN_HARDWARE) + 1,
    ),
)
def test_a_current_that_is_not_the_one_that_was_set_ends_the_trial(
    side: Any, amplifier: str, name: str, tmp_path: Path
) -> None:
    tick = TICK_APPROACHING if amplifier == "voltage" else TICK_AT_REST
    breaks = (tick, set_hardware(**BROKEN_HARDWARE[name]))
    device, recording, error = run_trial(tmp_path, *side, breaks, **{"rig.amplifier.drive": amplifier})
    assert isinstance(error, DeviceFaultError), error
    assert Fault.CURRENT_MISMATCH.text in error.message
    assert error.remedy
    assert device.current == 0
    rows = recording.rows
    ticks = rows["sample_index"][-1] - rows["sample_index"][0]
    assert ticks / RATE < tick / RATE + 2.0 * WINDOW_S  # rest of this window, and the next one
    judged = judge(recording, config.override(BASE, {"controller.loop": side[1]})).verdict
    assert judged.kind is Kind.INVALID


def device_stops_comparing(device: Any) -> None:
    device._safety.currents[CURRENT.noise] = _UNOBSERVED


@pytest.mark.parametrize("name", first_by_default(BROKEN_HARDWARE, 2))
def test_the_host_detects_a_wrong_current_without_the_device(name: str, tmp_path: Path) -> None:
    stops = (TICK_AT_REST, device_stops_comparing)
    breaks = (TICK_AT_REST, set_hardware(**BROKEN_HARDWARE[name]))
    device, recording, error = run_trial(tmp_path, SimulatedDevice, "host", stops, breaks)
    assert isinstance(error, GuardError), error
    assert "measured current" in error.message
    assert device.current == 0
    assert recording.rows["current_sent"][-1] == 0
    judged = judge(recording, BASE).verdict
    assert judged.kind is Kind.INVALID
    assert "measured current" in judged.reasons[0]


def test_a_current_too_small_beside_the_noise_is_not_observed_and_no_agreement(tmp_path: Path) -> None:
    noisy = {"rig.amplifier.current_noise_a": 1.0}
    _, recording, error = run_trial(tmp_path, SimulatedDevice, "host", (10, set_hardware(gain=0.0)), **noisy)
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
    _, recording, error = run_trial(
        tmp_path,
        SimulatedDevice,
        "host",
        (TICK_AT_REST, set_hardware(leak=2 * over)),  # twice, because the motor's own current adds to it
        (TICK_AT_REST + spikes, set_hardware(leak=0)),
    )
    assert (np.abs(recording.rows["current_measured"]) >= over * QUANTUM_A).sum() == spikes
    if spikes == 1:
        assert error is None
    else:
        assert isinstance(error, DeviceFaultError)
        assert Fault.OVER_CURRENT.text in error.message


@DEVICES_AND_LOOPS
def test_the_zero_of_the_sensor_is_taken_off_while_the_amplifier_is_off(
    device_class: Any, loop: str, tmp_path: Path
) -> None:
    """Without this correction a sensor offset of 60 quanta would count as a mismatch in every window at rest."""
    experiment = config.override(BASE, {"controller.loop": loop})
    device = device_class(config.rig_model(experiment), initial_position=START)
    link = MemoryLink(device, Faults())
    device.hardware.leak = 60  # quanta
    link.elapse(1.0)  # the device is not armed yet
    with FramedDevice(link) as framed:
        trial_on(framed, experiment, tmp_path / "trial.rigcap", sealed=False)
    rows = open_recording(tmp_path / "trial.rigcap").rows
    quantum = experiment.rig.amplifier.current_quantum_a
    has_no_current = rows["current_applied"] == 0
    has_no_current[1:] &= has_no_current[:-1]  # nor in the tick before
    assert not (rows["flags"] & RowFlag.CURRENT_DIFFERS).any()
    assert np.abs(rows["current_measured"][has_no_current]).max(initial=0.0) <= 2 * quantum


def test_a_device_that_applies_another_current_than_the_commanded_one_is_detected(tmp_path: Path) -> None:
    class InexactDevice(SimulatedDevice):
        is_inexact = False

        def tick(self) -> bytes:
            if self.is_inexact and self.connection.state is State.RUNNING:
                self.board.rules[AT.wanted] += 7  # quanta more than the command contains
            return super().tick()

    def become_inexact(device: Any) -> None:
        device.is_inexact = True

    _, recording, _ = run_trial(tmp_path, InexactDevice, "host", (TICK_AT_REST, become_inexact))
    assert (recording.rows["flags"] & RowFlag.OTHER_CURRENT).sum() > 100
    judged = judge(recording, BASE).verdict
    assert judged.kind is Kind.INVALID
    assert "and the set current from the commanded one" in judged.reasons[0]
