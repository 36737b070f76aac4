"""The firmware as a process behind a pseudo-terminal, in real time: the law on it, and a host that is told to break.

As in test_faults_realtime.py nothing depends on the processors that the machine has left, every wait is bounded by
seconds, and the device's own witness says that it ended without current.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.core.errors import DeviceFaultError, LinkLostError, RigError, StoppedError
from rig.devices import open_device
from rig.devices.fault_script import Direction, FrameFault, Kind
from rig.experiments.replay import replay
from rig.recording.reader import open_recording
from tests.conformance.far_end import FarEnd, HostProcess, Script, patient_host
from tests.conformance.firmware import need_compiler
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import trial_on

RATE = 2_000
EARLY = 200  # ticks of RUNNING before something breaks

SHORT = config.override(
    config.with_realtime(presets.load("koul-compliant")),
    {
        "controller.loop": "device",
        "controller.position_rate": RATE,
        "controller.velocity_rate": 500,
        "trial.duration_s": 0.2,
        "trial.release_s": 0.02,
        "homing.settle_s": 0.02,
        "verdict.tail_s": 0.05,
    },
)
LONG = config.override(SHORT, {"trial.duration_s": 60.0})
MODEL = config.rig_model(SHORT)
Start = Callable[..., FarEnd]


@pytest.fixture(autouse=True)
def _compiler() -> None:
    need_compiler()


@pytest.fixture
def far_end(tmp_path: Path) -> Iterator[Start]:
    started: list[FarEnd] = []

    def start(**script: Any) -> FarEnd:
        end = FarEnd("pty", tmp_path, MODEL, Script(after=EARLY, **script), RATE, firmware=True)
        started.append(end)
        return end

    yield start
    for one in started:
        one.close()


class Run:
    """One trial on a far end, brought to its end whatever that is."""

    def __init__(self, device: FarEnd, directory: Path, experiment: config.Experiment = SHORT) -> None:
        self.device = device
        self.path = directory / "trial.rigcap"
        self.error: RigError | None = None
        request = partial(
            trial_on, experiment=experiment, recording=self.path, verified=True, seed=0, sealed=False
        )
        try:
            with patient_host(), open_device(device.url) as opened:
                request(opened)
        except RigError as error:
            self.error = error

    def check(self, *errors: type[RigError]) -> Run:
        """It ended with one of these errors, or without any; the device at rest; a whole recording that replays."""
        assert isinstance(self.error, errors or type(None)), self.error
        assert self.error is None or self.error.remedy
        self.device.wait_for_rest()
        recording = open_recording(self.path)
        assert recording.complete
        assert not recording.lost
        assert replay(recording).exact
        return self


@pytest.mark.exhaustive(
    "tests/system/test_faults_of_a_device_loop.py::test_a_fault_of_the_device_is_told_with_cause_and_remedy"
)
def test_without_a_fault_it_completes(far_end: Start, tmp_path: Path) -> None:
    device = far_end()
    run = Run(device, tmp_path).check()
    assert device["peak"] > 0, "it did push"
    assert device["bad_frames"] == 0
    trailer = open_recording(run.path).trailer
    assert trailer is not None
    assert trailer["counters"]["bad_frames"] == 0


@pytest.mark.parametrize("direction", Direction)
@pytest.mark.exhaustive(
    "tests/system/test_faults_of_a_device_loop.py::test_a_fault_of_the_device_is_told_with_cause_and_remedy"
)
def test_silence_is_a_lost_link_and_a_ramp_to_zero(
    direction: Direction, far_end: Start, tmp_path: Path
) -> None:
    device = far_end(frames=(FrameFault(kind=Kind.SILENCE, direction=direction, frame=0),))
    Run(device, tmp_path, LONG).check(LinkLostError)
    assert device["acted"]
    assert device["first_fault"] == Fault.LINK_LOST


@pytest.mark.exhaustive(
    "tests/system/test_faults_of_a_device_loop.py::test_a_fault_of_the_device_is_told_with_cause_and_remedy"
)
def test_a_pulled_plug_is_a_lost_link_and_the_device_ends_by_itself(far_end: Start, tmp_path: Path) -> None:
    device = far_end(frames=(FrameFault(kind=Kind.UNPLUG, direction=Direction.TO_HOST, frame=0),))
    Run(device, tmp_path, LONG).check(LinkLostError)
    assert device["acted"]
    assert device["first_fault"] == Fault.LINK_LOST


@pytest.mark.parametrize("fault", [Fault.ENCODER, Fault.EMERGENCY_STOP, Fault.OVER_CURRENT])
@pytest.mark.exhaustive(
    "tests/system/test_faults_of_a_device_loop.py::test_a_fault_of_the_device_is_told_with_cause_and_remedy"
)
def test_a_fault_of_the_device_is_told_with_its_remedy(fault: Fault, far_end: Start, tmp_path: Path) -> None:
    device = far_end(fault=fault)
    run = Run(device, tmp_path, LONG).check(DeviceFaultError)
    assert device["first_fault"] == fault
    assert run.error is not None
    assert fault.text in run.error.message


@pytest.mark.exhaustive(
    "tests/system/test_faults_of_a_device_loop.py::test_a_fault_of_the_device_is_told_with_cause_and_remedy"
)
def test_a_brown_out_is_told(far_end: Start, tmp_path: Path) -> None:
    device = far_end(brown_out=True)
    by_its_silence, by_what_it_says_after_its_reset = LinkLostError, StoppedError
    Run(device, tmp_path, LONG).check(by_its_silence, by_what_it_says_after_its_reset)
    with patient_host(), open_device(device.url) as opened:
        opened.identify()
        assert opened.fault_report().name == Fault.WATCHDOG_RESET.name


@pytest.mark.parametrize("number", first_by_default([signal.SIGKILL, signal.SIGINT, signal.SIGSTOP]))
@pytest.mark.signals
def test_a_signal_to_the_host_leaves_the_device_at_rest(
    number: signal.Signals, far_end: Start, tmp_path: Path
) -> None:
    """Ctrl-C stops it by STOP; after kill -9, and behind a host that stands still, it ramps down by itself.

    The next host finds it usable.
    """
    device, path = far_end(), tmp_path / "trial.rigcap"
    host = HostProcess(device.url, LONG, path)
    try:
        device.wait_for(lambda w: w["running"] > EARLY, "the host moves nothing")
        host.send(number)
        device.wait_for_rest()
        if number == signal.SIGSTOP:
            host.send(signal.SIGCONT)
        said = host.ended()
    finally:
        host.close()
    expected = {signal.SIGINT: "StoppedError", signal.SIGKILL: "killed", signal.SIGSTOP: "DeviceFaultError"}
    assert said == expected[number]
    recording = open_recording(path)
    assert recording.complete == (said != "killed")
    if said == "killed":
        assert device["first_fault"] == Fault.LINK_LOST
        (tmp_path / "next").mkdir()
        Run(device, tmp_path / "next").check()
