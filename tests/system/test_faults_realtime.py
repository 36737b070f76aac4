"""Faults in real time over a pseudo-terminal to a device process.

Nothing depends on spare processors (`tests.conformance.far_end`) or asserts a latency: the device ends without current,
as its own log shows, and the recording can be read.
"""

import resource
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.core.errors import DeviceFaultError, DeviceNotFoundError, LinkLostError, RecordingError
from rig.devices import open_device
from rig.devices.fault_script import Direction, FaultKind, FrameFault
from rig.recording.reader import open_recording
from tests.conformance.far_end import FarEnd, HostProcess, Script
from tests.conformance.firmware import need_compiler
from tests.conformance.struck import StruckTrial
from tests.conformance.tiers import first_by_default

COMMON = {"trial.release_s": 0.02, "homing.settle_s": 0.02, "verdict.tail_s": 0.05}
ON_HOST = {
    "controller.position_rate": 500,
    "controller.velocity_rate": 500,
    "controller.parameters": {"cutoff_hz": 100.0},
    "controller.command_lifetime_s": 0.02,
    "trial.duration_s": 0.15,
    "verdict.lowpass_hz": 200.0,
}
ON_DEVICE = {
    "controller.loop": "device",
    "controller.position_rate": 2_000,
    "controller.velocity_rate": 500,
    "trial.duration_s": 0.2,
}


@dataclass(frozen=True)
class Bench:
    """Devices behind a port and trials on them; a fault is injected after `early` ticks of RUNNING."""

    directory: Path
    changes: dict[str, Any]
    early: int
    started: list[FarEnd]

    @property
    def firmware(self) -> bool:
        return self.changes is ON_DEVICE

    @property
    def experiment(self) -> config.Experiment:
        return config.override(
            config.with_realtime(presets.load("koul-compliant")), {**COMMON, **self.changes}
        )

    @property
    def long(self) -> config.Experiment:
        return config.override(self.experiment, {"trial.duration_s": 60.0})

    def start(self, **script: Any) -> FarEnd:
        model, rate = config.rig_model(self.experiment), int(self.experiment.controller.position_rate)
        self.started.append(
            FarEnd(self.directory, model, Script(after=self.early, **script), rate, firmware=self.firmware)
        )
        return self.started[-1]

    def run(self, device: FarEnd, *, long: bool = True, **options: Any) -> StruckTrial:
        return StruckTrial(device, self.directory, self.long if long else self.experiment, **options)


BENCHES = {"the law on the host": (ON_HOST, 30), "the law on the firmware": (ON_DEVICE, 200)}


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    """Return a bench whose law runs on the host, or on the device if the test is parametrised so."""
    changes, early = BENCHES[getattr(request, "param", "the law on the host")]
    made = Bench(tmp_path, changes, early, [])
    if made.firmware:
        need_compiler()
    yield made
    for one in made.started:
        one.close()


on_both = pytest.mark.parametrize("bench", first_by_default(BENCHES), indirect=True)


def broken(kind: FaultKind, *directions: Direction, strikes: int = 1) -> tuple[FrameFault, ...]:
    return tuple(
        FrameFault(kind=kind, direction=direction, frame=5 * number + 2 * strike, byte=7, bit=3, ticks=3)
        for number, direction in enumerate(directions)
        for strike in range(strikes)
    )


# What breaks → script, error, the first fault of the device.
ENDINGS: dict[str, tuple[dict[str, Any], type[Exception], Fault]] = {
    "a pulled plug": ({"frames": broken(FaultKind.UNPLUG, Direction.TO_HOST)}, LinkLostError, Fault.LINK_LOST),
    "silence to the device": (
        {"frames": broken(FaultKind.SILENCE, Direction.TO_DEVICE)}, LinkLostError, Fault.LINK_LOST,
    ),
    "silence to the host": (
        {"frames": broken(FaultKind.SILENCE, Direction.TO_HOST)}, LinkLostError, Fault.LINK_LOST,
    ),
    **{
        fault.name: ({"fault": fault}, DeviceFaultError, fault)
        for fault in (Fault.ENCODER, Fault.EMERGENCY_STOP, Fault.OVER_CURRENT)
    },
}  # fmt: skip


@on_both
@pytest.mark.parametrize("name", first_by_default(ENDINGS))
def test_an_ended_run_has_an_error_with_its_remedy_and_a_device_at_rest(name: str, bench: Bench) -> None:
    script, error, fault = ENDINGS[name]
    device = bench.start(**script)
    trial = bench.run(device).check(error, replays=bench.firmware)  # type: ignore[arg-type]
    assert device["first_fault"] == fault
    assert device["acted"] or error is DeviceFaultError
    assert fault.text in trial.error.message or error is LinkLostError  # type: ignore[union-attr]
    assert name != "a pulled plug" or trial.recording.trailer["reason"] == "link_closed"


@on_both
@pytest.mark.parametrize(
    "number", first_by_default([signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGSTOP])
)
@pytest.mark.signals
def test_a_signal_to_a_host_process_leaves_the_device_at_rest(number: Any, bench: Bench) -> None:
    """The device latches LINK_LOST for a host that vanished; the next host clears it."""
    device, path = bench.start(), bench.directory / "trial.rigcap"
    host = HostProcess(device.url, bench.long, path)
    try:
        device.wait_for(
            lambda w: w["running"] > bench.early or not host.process.is_alive(), "the host moves nothing"
        )
        assert host.process.is_alive(), f"the host ended with {host.ended()!r}"
        host.send(number)
        device.wait_for_rest()
        if number == signal.SIGSTOP:
            host.send(signal.SIGCONT)
        ending = host.ended()
    finally:
        host.close()
    expected = {
        signal.SIGINT: "StoppedError",
        signal.SIGTERM: "StoppedError",
        signal.SIGKILL: "killed",
        signal.SIGSTOP: "DeviceFaultError",
    }[number]
    assert ending == expected
    assert open_recording(path).complete == (ending != "killed")
    if ending == "killed":
        assert device["first_fault"] == Fault.LINK_LOST
        assert device["state"] == State.FAULT
        path.unlink()
        bench.run(device, long=False).check(replays=bench.firmware)


@pytest.mark.exhaustive(
    "tests/system/test_faults.py::test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording"
)
def test_a_full_disk_is_reported_at_the_end_and_the_device_is_at_rest(bench: Bench) -> None:
    """A file size limit stands in for a full disk: it gives EFBIG where that gives ENOSPC, on the same path."""
    device = bench.start()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill_the_disk(ticks: Any, phase: Any) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, before[1]))

    try:
        trial = bench.run(device, long=False, progress=fill_the_disk)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert isinstance(trial.error, RecordingError)
    device.wait_for_rest()
    assert not trial.recording.complete
    assert (np.diff(trial.rows["tick"]) == 1).all()


def test_a_device_that_another_program_has_open_is_refused_before_anything_moves(bench: Bench) -> None:
    device = bench.start()
    with open_device(device.url):
        trial = bench.run(device)
    assert isinstance(trial.error, DeviceNotFoundError)
    assert device["running"] == 0
    assert not trial.path.exists()
