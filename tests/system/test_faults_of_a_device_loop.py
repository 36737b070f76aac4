"""What goes wrong in the world of a device, told by the shipped host: a typed error with cause and remedy, zero effort.

In virtual time; the far end is the firmware, the law runs on it or in the host. What the line can do to frames is in
test_device_loop_faults.py and test_faults.py; what the device does, tick by tick, in tests/firmware.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.core.errors import (
    DeviceFaultError,
    DeviceRefusedError,
    GuardError,
    LinkLostError,
    RigError,
    StoppedError,
)
from rig.core.sample import Phase
from rig.devices.fault_script import Faults, Happening
from rig.devices.framed import FramedDevice
from rig.experiments.replay import replay
from rig.recording.reader import open_recording
from sim_backend.firmware import FirmwareDevice
from sim_backend.link import MemoryLink
from tests.conformance.firmware import need_compiler
from tests.conformance.trials import trial_on

RATE = 2_000
START = -0.015
STRIKE = 900  # ticks of the link: in the trial, some hundred behind the impact
ENDED_S = 0.05  # lifetime and ramp of either loop, and as much again
LOOPS = ("host", "device")
BASE = config.override(
    presets.load("koul-compliant"),
    {
        "controller.position_rate": RATE,
        "controller.velocity_rate": 500,
        "trial.duration_s": 1.0,
        "trial.release_s": 0.01,
        "homing.settle_s": 0.01,
        "verdict.tail_s": 0.2,
    },
)


@pytest.fixture(autouse=True)
def _compiler() -> None:
    need_compiler()


class Bench:
    """The firmware with a script of the world, and one trial on it."""

    def __init__(self, directory: Path, loop: str, *happenings: Happening, **changes: Any) -> None:
        self.experiment = config.override(BASE, {"controller.loop": loop, **changes})
        self.device = FirmwareDevice(config.rig_model(self.experiment), initial_position=START)
        self.link = MemoryLink(self.device, Faults(device=happenings))
        self.path = directory / "trial.rigcap"
        self.error: RigError | None = None

    def run(self) -> Bench:
        request = partial(
            trial_on, experiment=self.experiment, recording=self.path, verified=True, seed=0, sealed=False
        )
        try:
            with FramedDevice(self.link) as device:
                request(device)
        except RigError as error:
            self.error = error
        return self

    def check_at_rest(self) -> np.ndarray:
        """No effort now and later; a recording that reads and replays; its rows."""
        self.link.elapse(ENDED_S)
        for _ in range(10):
            assert self.device.current == 0
            self.link.elapse(0.1)
        assert self.device.state not in (State.ARMED, State.RUNNING)
        assert abs(self.device.hardware.effort) < 1e-6
        recording = open_recording(self.path)
        assert recording.complete
        assert not recording.lost
        assert replay(recording).exact
        return np.asarray(recording.rows)


def at(act: Callable[[FirmwareDevice], None], tick: int = STRIKE) -> Happening:
    return Happening(tick, act)


def push(effort: float) -> Callable[[FirmwareDevice], None]:
    return lambda device: setattr(device.hardware, "external_effort", effort)


def slip(counts: int) -> Callable[[FirmwareDevice], None]:
    return lambda device: setattr(device.hardware, "slip", counts)


CASES: dict[str, tuple[Callable[[FirmwareDevice], None], tuple[Fault, ...]]] = {
    "an encoder that jumps": (slip(1_500), (Fault.OVER_SPEED, Fault.BATCH_OVERFLOW)),
    "an illegal transition": (FirmwareDevice.fail_encoder, (Fault.ENCODER,)),
    "a short circuit": (lambda device: setattr(device.hardware, "leak", 32_767), (Fault.OVER_CURRENT,)),
    "the emergency stop": (FirmwareDevice.press_emergency_stop, (Fault.EMERGENCY_STOP,)),
    "a law that is not finite": (lambda device: device.inject_fault(Fault.NON_FINITE), (Fault.NON_FINITE,)),
    "a tick that takes too long": (
        lambda device: device.inject_fault(Fault.TICK_OVERRUN),
        (Fault.TICK_OVERRUN,),
    ),
    "a watchdog reset of a port": (lambda device: device.inject_fault(Fault.INTERNAL), (Fault.INTERNAL,)),
}


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("name", CASES)
def test_a_fault_of_the_device_is_told_with_cause_and_remedy(name: str, loop: str, tmp_path: Path) -> None:
    act, faults = CASES[name]
    bench = Bench(tmp_path, loop, at(act)).run()
    assert isinstance(bench.error, DeviceFaultError), bench.error
    told = bench.device.fault or next(fault for fault in faults if fault.text in bench.error.message)
    assert told in faults
    assert told.text in bench.error.message
    assert bench.error.remedy
    rows = bench.check_at_rest()
    assert rows["phase"][-2] == Phase.TRIAL
    assert rows["fault"][-1] in ((Fault.NONE, *faults) if loop == "device" else faults), "BATCH tells none"
    assert rows["current_sent"][-1] == 0 or loop == "device"
    trailer = open_recording(bench.path).trailer
    assert trailer is not None
    assert trailer["fault"]["name"] in {fault.name for fault in faults}
    assert len(trailer["fault"]["entries"]) > 50, "the ticks before it, as the device remembers them"


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("effort", [5.0, -1.0], ids=["a blow", "a pull"])
def test_a_handle_that_is_driven_beyond_its_limits_ends_the_run(
    effort: float, loop: str, tmp_path: Path
) -> None:
    """Whoever sees it first, the guard of the law or the device's monitor."""
    bench = Bench(tmp_path, loop, at(push(effort)), **{"rig.limits.position_minimum": -0.02}).run()
    assert isinstance(bench.error, GuardError | DeviceFaultError)
    assert bench.error.remedy
    bench.check_at_rest()


@pytest.mark.parametrize("loop", LOOPS)
def test_a_brown_out_in_mid_run_is_a_lost_link_and_then_a_reset_that_says_so(
    loop: str, tmp_path: Path
) -> None:
    bench = Bench(tmp_path, loop, at(FirmwareDevice.brown_out)).run()
    assert isinstance(bench.error, LinkLostError | DeviceFaultError | StoppedError), bench.error
    assert bench.error.remedy
    rows = bench.check_at_rest()
    assert rows["phase"][-1] == Phase.TRIAL
    before = bench.device.truth()
    assert len(before) == 0, "no session since"
    assert bench.device.hardware.count != 0 or bench.device.sample_index > 0
    with FramedDevice(MemoryLink(bench.device)) as device:
        device.identify()
        report = device.fault_report()
        assert report.name == Fault.WATCHDOG_RESET.name
        assert report.remedy


@pytest.mark.parametrize("loop", LOOPS)
def test_a_released_switch_is_no_effort_and_no_fault_of_the_device(loop: str, tmp_path: Path) -> None:
    released = at(lambda device: device.hold_to_run(False))
    bench = Bench(tmp_path, loop, released, **{"trial.kind": "human"})
    bench.device.hold_to_run(True)
    bench.run()
    assert bench.device.fault is Fault.NONE
    rows = bench.check_at_rest()
    assert not rows["current_applied"][rows["sample_index"] > rows["sample_index"][0] + STRIKE + 5].any()


@pytest.mark.parametrize("loop", LOOPS)
def test_a_device_that_is_not_safe_does_not_arm(loop: str, tmp_path: Path) -> None:
    bench = Bench(tmp_path, loop)
    bench.device.press_emergency_stop()
    bench.run()
    assert isinstance(bench.error, DeviceRefusedError)
    assert Fault.EMERGENCY_STOP.text in str(bench.error)
    assert not bench.path.exists()
    assert len(bench.device.truth()) == 0
