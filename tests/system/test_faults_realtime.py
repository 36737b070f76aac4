"""Every fault again, in real time, over a real port: a device process at the other end of a line that breaks.

Nothing here depends on the processors that the machine has left (`tests.conformance.far_end`), and nothing is asserted
about latency: every wait is bounded by seconds, the device ends without current (its own witness says so), the
recording reads, and what the line lost is counted.
"""

import resource
import signal
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.control.law import Law
from rig.core.errors import (
    DeviceFaultError,
    DeviceNotFoundError,
    GuardError,
    LawError,
    LinkLostError,
    RecordingError,
    RigError,
    StoppedError,
)
from rig.core.sample import Phase
from rig.devices import open_device
from rig.devices.fault_script import Direction, FrameFault, Kind
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_SIGNATURE
from rig.recording.reader import open_recording
from tests.conformance.far_end import PORTS, FarEnd, HostProcess, Script, patient_host
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import trial_on

BOUND_S = 60.0  # "it comes back", not how soon: a loaded machine may have to compile first
RATE = 500
EARLY = 30  # ticks of RUNNING before something breaks in the middle of a run

SHORT = config.override(
    config.with_realtime(presets.load("koul-compliant")),
    {
        "controller.position_rate": RATE,
        "controller.velocity_rate": RATE,
        "controller.parameters": {"cutoff_hz": 100.0},
        "controller.command_lifetime_s": 0.02,
        "trial.duration_s": 0.15,
        "trial.release_s": 0.02,
        "homing.settle_s": 0.02,
        "verdict.tail_s": 0.05,
        "verdict.lowpass_hz": 200.0,
    },
)
LONG = config.override(SHORT, {"trial.duration_s": 60.0})
MODEL = config.rig_model(SHORT)


@pytest.fixture(params=sorted(PORTS))
def far_end(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Any]:
    """Start devices behind a port; the suite runs over every kind of port that there is."""
    started = []

    def start(script: Any = None) -> Any:
        started.append(FarEnd(request.param, tmp_path, MODEL, script or Script(), RATE))
        return started[-1]

    yield start
    for one in started:
        one.close()


class Run:
    """One trial on a far end: its error, its recording, and that everything was bounded."""

    def __init__(
        self,
        device_end: Any,
        directory: Any,
        *,
        experiment: Any = SHORT,
        law: Any = None,
        progress: Any = None,
    ) -> None:
        self.far_end = device_end
        self.path = directory / "trial.rigcap"
        self.error = None
        began = time.monotonic()
        request = partial(
            trial_on,
            experiment=experiment,
            recording=self.path,
            verified=True,
            seed=0,
            law=law,
            progress=progress,
            sealed=False,
        )
        try:
            with patient_host(), open_device(device_end.url) as device:
                request(device)
        except RigError as error:
            self.error = error
        assert time.monotonic() - began < experiment.trial.duration_s + BOUND_S

    @property
    def counters(self) -> Any:
        return self.recording().trailer["counters"]

    def recording(self) -> Any:
        return open_recording(self.path)

    def check(self, *errors: type[RigError]) -> Any:
        """It ended with one of these errors, or without any; the device at rest; a recording that is whole."""
        assert isinstance(self.error, errors or type(None)), self.error
        if self.error is not None:
            assert self.error.remedy or isinstance(self.error, StoppedError)
        self.far_end.wait_for_rest()
        recording = self.recording()
        assert recording.complete
        assert not recording.lost
        assert len(recording.rows) + self.counters["rows_dropped"] == self.counters["ticks"]
        return self


def broken(kind: Any, *directions: Any, strikes: int = 1) -> Any:
    return Script(
        after=EARLY,
        frames=tuple(
            FrameFault(kind=kind, direction=direction, frame=5 * number + 2 * strike, byte=7, bit=3, ticks=3)
            for number, direction in enumerate(directions)
            for strike in range(strikes)
        ),
    )


# ---------------------------------------------------------------------- the line

COUNTER = {
    Kind.DROP: "lost",
    Kind.CORRUPT: "bad_frames",
    Kind.TRUNCATE: "bad_frames",
    Kind.DUPLICATE: "duplicated",
    Kind.REORDER: "reordered",
}


def test_without_a_fault_it_completes(far_end: Any, tmp_path: Path) -> None:
    device = far_end()
    run = Run(device, tmp_path).check()
    assert device["peak"] > 0, "it did push"
    assert device["bad_frames"] == 0
    assert run.counters["bad_frames"] == 0


@pytest.mark.parametrize("kind", [*COUNTER, Kind.DELAY])
@pytest.mark.exhaustive(
    "tests/system/test_faults.py::test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording"
)
def test_a_bad_frame_each_way_costs_itself_and_is_counted_where_it_should_have_come(
    kind: Any, far_end: Any, tmp_path: Path
) -> None:
    device = far_end(
        broken(kind, *Direction, strikes=2)
    )  # one of them may compare clocks: a lost one is not counted
    run = Run(device, tmp_path).check()
    assert device["acted"] == 2 * len(Direction)
    if kind is not Kind.DELAY:
        assert device[COUNTER[kind]] >= 1
        assert run.counters[COUNTER[kind]] >= 1


@pytest.mark.parametrize("direction", first_by_default(Direction))
def test_silence_is_a_lost_link_and_a_ramp_to_zero(direction: Any, far_end: Any, tmp_path: Path) -> None:
    device = far_end(broken(Kind.SILENCE, direction))
    Run(device, tmp_path, experiment=LONG).check(LinkLostError)
    assert device["acted"]
    assert device["first_fault"] == Fault.LINK_LOST


def test_a_pulled_plug_is_a_lost_link(far_end: Any, tmp_path: Path) -> None:
    device = far_end(broken(Kind.UNPLUG, Direction.TO_HOST))
    run = Run(device, tmp_path, experiment=LONG).check(LinkLostError)
    assert run.recording().trailer["reason"] == "link_closed"
    assert device["first_fault"] == Fault.LINK_LOST


@pytest.mark.exhaustive(
    "tests/system/test_faults.py::test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording"
)
def test_a_flood_of_noise_is_counted_and_a_lost_link(far_end: Any, tmp_path: Path) -> None:
    """Each sample is glued to the noise before it: none arrives."""
    device = far_end(Script(after=EARLY, flood=True))
    run = Run(device, tmp_path, experiment=LONG).check(LinkLostError)
    assert run.counters["bad_frames"] > 10
    assert device["first_fault"] == Fault.LINK_LOST


# ---------------------------------------------------------------------- the device


@pytest.mark.parametrize("fault", [Fault.ENCODER, Fault.EMERGENCY_STOP, Fault.OVER_CURRENT])
@pytest.mark.exhaustive(
    "tests/system/test_faults.py::test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording"
)
def test_a_fault_of_the_device_is_told_with_its_remedy(fault: Any, far_end: Any, tmp_path: Path) -> None:
    device = far_end(Script(after=EARLY, fault=fault))
    run = Run(device, tmp_path, experiment=LONG).check(DeviceFaultError)
    assert device["first_fault"] == fault
    assert fault.text in run.error.message
    assert run.recording().rows["current_sent"][-1] == 0


@pytest.mark.exhaustive(
    "tests/system/test_faults.py::test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording"
)
def test_a_device_that_dies_is_a_lost_link(far_end: Any, tmp_path: Path) -> None:
    device = far_end()

    def kill(ticks: Any, phase: Any) -> None:
        if ticks > EARLY and device.process.is_alive():
            device.kill()

    run = Run(device, tmp_path, experiment=LONG, progress=kill)
    assert isinstance(run.error, LinkLostError)
    assert run.error.remedy
    assert run.recording().complete


@pytest.mark.exhaustive(
    "tests/system/test_faults.py::test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording"
)
def test_a_device_that_stands_still_is_a_lost_link_and_ramps_when_it_goes_on(
    far_end: Any, tmp_path: Path
) -> None:
    device = far_end()
    paused = []

    def pause(ticks: Any, phase: Any) -> None:
        if ticks > EARLY and not paused:
            device.pause()
            paused.append(ticks)

    run = Run(device, tmp_path, experiment=LONG, progress=pause)
    device.go_on()
    run.check(LinkLostError)


# ---------------------------------------------------------------------- the law


@kernel(LAW_SIGNATURE)
def gives_nan(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[1] += 1.0
    return np.nan if state[1] > 30.0 else 0.0


@kernel(LAW_SIGNATURE)
def raises(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[1] += 1.0
    if state[1] > 30.0:
        raise ValueError("too deep for me")
    return 0.0


@pytest.mark.parametrize(("function", "reason"), [(gives_nan, "nonfinite"), (raises, "law_raised")])
@pytest.mark.exhaustive(
    "tests/system/test_faults.py::test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording"
)
def test_a_law_that_fails_ends_the_run_with_zero(
    function: Any, reason: str, far_end: Any, tmp_path: Path
) -> None:
    law = Law("bad", "for this test", function, 2, lambda wall: [])
    run = Run(far_end(), tmp_path, experiment=LONG, law=law).check(LawError)
    assert run.recording().trailer["reason"] == reason


@pytest.mark.exhaustive(
    "tests/system/test_faults.py::test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording"
)
def test_leaving_the_window_ends_the_run_with_zero(far_end: Any, tmp_path: Path) -> None:
    narrow = config.override(
        LONG, {"rig.limits.position_maximum": 0.0005, "wall.stiffness": 60.0, "wall.damping": 0.0}
    )
    device = far_end()
    run = Run(device, tmp_path, experiment=narrow).check(
        GuardError, DeviceFaultError
    )  # both look, every tick
    if isinstance(run.error, DeviceFaultError):
        assert device["first_fault"] == Fault.POSITION_WINDOW


# ---------------------------------------------------------------------- the host


@pytest.mark.exhaustive(
    "tests/system/test_faults.py::test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording"
)
def test_an_exception_of_the_caller_ends_the_run_with_zero(far_end: Any, tmp_path: Path) -> None:
    device = far_end()

    def break_down(ticks: Any, phase: Any) -> None:
        if ticks > EARLY:
            raise ZeroDivisionError("a bug in a progress bar")

    with pytest.raises(ZeroDivisionError):
        Run(device, tmp_path, experiment=LONG, progress=break_down)
    device.wait_for_rest()
    assert open_recording(tmp_path / "trial.rigcap").complete


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.signals
def test_a_signal_stops_the_loop_and_leaves_a_whole_recording(
    number: Any, far_end: Any, tmp_path: Path
) -> None:
    device = far_end()
    sent = []

    def interrupt(ticks: Any, phase: Any) -> None:
        if ticks > EARLY and not sent:
            sent.append(ticks)
            signal.raise_signal(number)

    run = Run(device, tmp_path, experiment=LONG, progress=interrupt).check(StoppedError)
    assert run.recording().rows["phase"][-1] in (Phase.HOMING, Phase.TRIAL)


@pytest.mark.parametrize(
    "number", first_by_default([signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGSTOP])
)
@pytest.mark.signals
def test_a_signal_to_a_host_process_leaves_the_device_at_rest(
    number: Any, far_end: Any, tmp_path: Path
) -> None:
    """From outside, as a person, a session manager and the kernel send them; a stopped host is like a dead one.

    The device has latched LINK_LOST for a host that vanished; the next one clears it and says so.
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
    expected = {
        signal.SIGINT: "StoppedError",
        signal.SIGTERM: "StoppedError",
        signal.SIGKILL: "killed",
        signal.SIGSTOP: "DeviceFaultError",
    }[number]
    assert said == expected
    recording = open_recording(path)
    assert recording.complete == (said != "killed")
    if said == "killed":
        assert device["first_fault"] == Fault.LINK_LOST
        assert device["state"] == State.FAULT
        (tmp_path / "next").mkdir()
        Run(device, tmp_path / "next").check()


@pytest.mark.exhaustive(
    "tests/system/test_faults.py::test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording"
)
def test_a_full_disk_is_told_at_the_end_and_the_device_is_at_rest(far_end: Any, tmp_path: Path) -> None:
    """A limit on the size of files stands for it: the same path, with EFBIG for ENOSPC."""
    device = far_end()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill_the_disk(ticks: Any, phase: Any) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, before[1]))

    try:
        run = Run(device, tmp_path, progress=fill_the_disk)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert isinstance(run.error, RecordingError)
    device.wait_for_rest()
    recording = run.recording()
    assert not recording.complete
    assert (np.diff(recording.rows["tick"]) == 1).all()


def test_a_device_that_somebody_else_has_open_is_refused_before_anything_moves(
    far_end: Any, tmp_path: Path
) -> None:
    device = far_end()
    with open_device(device.url):
        run = Run(device, tmp_path)
    assert isinstance(run.error, DeviceNotFoundError)
    assert device["running"] == 0
    assert not (tmp_path / "trial.rigcap").exists()
