"""After any exit of a run the process holds the same threads, descriptors, children, shared memory and scheduling.

`test_live_realtime` tests an exit by kill -9.
"""

import gc
import os
import signal
import sys
import threading
import time
import uuid
from collections.abc import Iterator
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import pytest

import rig.cli
from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.control.law import Law
from rig.core.errors import (
    DeviceNotFoundError,
    LawError,
    LinkLostError,
    RealtimeError,
    RecordingError,
    RigError,
    StoppedError,
)
from rig.devices import open_device
from rig.devices.fault_script import DeviceFault, Direction, FaultKind, Faults, FrameFault
from rig.devices.framed import FramedDevice
from rig.recording.reader import open_recording
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.census import MARK, Census, marked, nothing_left, still_there
from tests.conformance.far_end import FarEnd, Script, patient_host
from tests.conformance.started import WAIT_S, started
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import trial_on
from tests.system.test_faults import gives_nan, raises
from tests.system.test_faults_realtime import COMMON, ON_HOST

RATE = 500
NO_SUCH_CPU = 4_095
EMPTY_CAPTURE_BYTES = 40_000  # at most; a header without rows

REAL = config.override(config.with_realtime(presets.load("koul-compliant")), {**COMMON, **ON_HOST})
MODEL = config.rig_model(REAL)


def law_of(function: Any) -> Any:
    return Law("bad", "for this test", function, 2, lambda wall: [])


class CallbackError(Exception):
    """An exception that the caller's code raises in the middle of a run."""


def breaks_down(ticks: Any, phase: Any) -> None:
    raise CallbackError


def interrupts(number: Any) -> Any:
    sent = []

    def progress(ticks: Any, phase: Any) -> None:
        if not sent:
            sent.append(number)
            signal.raise_signal(number)

    return progress


LONG = {"trial.duration_s": 30.0}

# kind of exit → (changes of the experiment, more of the request, errors that may end it)
EXITS = {
    "finished": ({}, {}, ()),
    "ctrl-c": (LONG, {"progress": lambda: interrupts(signal.SIGINT)}, (StoppedError,)),
    "sigterm": (LONG, {"progress": lambda: interrupts(signal.SIGTERM)}, (StoppedError,)),
    "exception": (LONG, {"progress": lambda: breaks_down}, (CallbackError,)),
    "law raises": (LONG, {"law": lambda: law_of(raises)}, (LawError,)),
    "law gives NaN": (LONG, {"law": lambda: law_of(gives_nan)}, (LawError,)),
    "no such cpu": ({"host.realtime": "enforce", "host.cpu": NO_SUCH_CPU}, {}, (RealtimeError,)),
    "tries": ({"host.realtime": "try"}, {}, ()),
    "changes nothing": ({"host.realtime": "off"}, {}, ()),
}


def test_the_census_detects_what_remains() -> None:
    before, done = Census.of_self(), threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    memory = os.memfd_create("haptic-rig")
    changes = before.changes(Census.of_self())
    os.close(memory)
    done.set()
    thread.join()
    assert {"threads", "tasks", "descriptors"} <= set(changes)


def run(device: Any, directory: Any, changes: Any, more: Any, allowed: Any) -> Any:
    """Run one trial; return the type of the error that ended it, if any."""
    try:
        trial_on(
            device,
            config.override(REAL, changes),
            directory / f"{uuid.uuid4().hex}.rigcap",
            **{name: make() for name, make in more.items()},
        )
    except allowed as error:
        return type(error)
    return None


# ---------------------------------------------------------------------- virtual time


def in_memory(faults: Any = None) -> Any:
    return FramedDevice(MemoryLink(SimulatedDevice(MODEL), faults or Faults()))


@pytest.fixture(autouse=True)
def frozen_objects() -> None:
    """Freeze the compilers' half a million objects, so that garbage collections in these tests are quick."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Run one trial first, so that whatever a process starts only once exists before anything is counted."""
    with in_memory() as device:
        run(device, tmp_path_factory.mktemp("warm"), *EXITS["finished"])


@pytest.mark.parametrize("exit_kind", first_by_default(EXITS, 4))
@pytest.mark.signals
def test_nothing_is_left_in_virtual_time(exit_kind: Any, warm: Any, tmp_path: Path) -> None:
    with nothing_left(), in_memory() as device:
        run(device, tmp_path, *EXITS[exit_kind])


FAULTS = {
    "unplugged": Faults(frames=(FrameFault(kind=FaultKind.UNPLUG, direction=Direction.TO_HOST, frame=120),)),
    "silence": Faults(frames=(FrameFault(kind=FaultKind.SILENCE, direction=Direction.TO_HOST, frame=120),)),
    "never there": Faults(frames=(FrameFault(kind=FaultKind.SILENCE, direction=Direction.TO_HOST, frame=0),)),
    "device fault": Faults(device=(DeviceFault(60, Fault.EMERGENCY_STOP),)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_nothing_is_left_of_a_lost_link_in_virtual_time(fault: Any, warm: Any, tmp_path: Path) -> None:
    with nothing_left(), in_memory(FAULTS[fault]) as device:
        run(device, tmp_path, LONG, {}, (RigError,))


def test_nothing_is_left_of_a_recording_that_cannot_be_made(warm: Any, tmp_path: Path) -> None:
    path = tmp_path / "there.rigcap"
    path.touch()
    with nothing_left(), in_memory() as device, pytest.raises(RecordingError):
        trial_on(device, experiment=REAL, recording=path, verified=True, seed=0)


# ---------------------------------------------------------------------- real time


@pytest.fixture
def far_end(tmp_path: Path) -> Iterator[Any]:
    """Return a function that starts a device process; the fork server of these processes stays alive."""
    started = []

    def start(script: Any = None) -> Any:
        started.append(FarEnd(tmp_path, MODEL, script or Script(), RATE))
        return started[-1]

    yield start
    for one in started:
        one.close()


@pytest.mark.parametrize("exit_kind", first_by_default(EXITS, 2))
def test_nothing_is_left_in_real_time(exit_kind: Any, warm: Any, far_end: Any, tmp_path: Path) -> None:
    device_end = far_end()
    changes, more, allowed = EXITS[exit_kind]
    with patient_host(), nothing_left(), open_device(device_end.url) as device:
        error = run(device, tmp_path, changes, more, allowed)
    assert issubclass(error, allowed) if allowed else error is None


# A silence takes 5 s, so the default tier has only the other fault.
@pytest.mark.parametrize("kind", first_by_default([FaultKind.UNPLUG, FaultKind.SILENCE]))
def test_nothing_is_left_of_a_lost_real_time_link(kind: Any, warm: Any, far_end: Any, tmp_path: Path) -> None:
    fault = FrameFault(kind=kind, direction=Direction.TO_HOST, frame=0)
    device_end = far_end(Script(after=20, frames=(fault,)))
    with patient_host(), nothing_left(), open_device(device_end.url) as device:
        run(device, tmp_path, LONG, {}, (LinkLostError,))


def test_nothing_is_left_of_a_port_that_does_not_open(warm: Any, far_end: Any) -> None:
    device_end = far_end()
    with open_device(device_end.url), nothing_left(), pytest.raises(DeviceNotFoundError):
        open_device(device_end.url)


QUICK = "hit --no-plot --duration 0.2 --set verdict.tail_s=0.1 --set trial.release_s=0.02 --realtime"


@pytest.mark.quiet
def test_nothing_is_left_of_a_command_and_the_process_that_was_its_device(
    warm: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    resource_tracker.ensure_running()  # what multiprocessing starts once, stays
    with nothing_left():
        code = rig.cli.run(QUICK.split())
    err = capfd.readouterr().err
    assert code == 0, err


# ---------------------------------------------------------------------- from outside


@pytest.mark.signals
@pytest.mark.quiet
def test_a_command_that_ctrl_c_ends_leaves_no_process_and_no_memory(tmp_path: Path) -> Any:
    mark = uuid.uuid4().hex
    before = set(os.listdir("/dev/shm"))
    command = (sys.executable, "-m", "rig", "hit", "--realtime", "--duration", "60")
    options = {"cwd": tmp_path, "env": {**os.environ, MARK: mark}, "start_new_session": True}
    with open(tmp_path / "output", "wb") as out, started(*command, stdout=out, stderr=out, **options) as hit:
        wait_until(lambda: has_rows(tmp_path) or hit.poll() is not None, lambda: "the trial does not begin")
        assert len(marked(mark)) >= 2 or hit.poll() is not None, "host and device at least"
        hit.send_signal(signal.SIGINT)  # nothing, when it has ended by itself
        hit.wait(WAIT_S)
    assert not still_there(mark)
    ours = {name for name in set(os.listdir("/dev/shm")) - before if "haptic" in name or "rig" in name}
    assert not ours
    text = (tmp_path / "output").read_text()
    assert "Traceback" not in text
    assert hit.returncode == StoppedError.exit_code, text
    assert "stopped" in text
    (recording,) = map(open_recording, tmp_path.glob("recordings/*.parquet"))
    assert (recording.complete, recording.trailer["reason"]) == (True, "stopped")


def has_rows(directory: Any) -> Any:
    return any(path.stat().st_size > EMPTY_CAPTURE_BYTES for path in directory.glob("recordings/*.rigcap"))


def wait_until(condition: Any, text: Any) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, text()
        time.sleep(0.02)
