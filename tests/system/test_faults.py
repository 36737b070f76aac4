"""What can break, breaks at every place of a short run; each time the effort ends at zero and the recording reads.

In virtual time, over the real frames, with the shipped loop. A run of one homing, a push and a release is
some forty ticks long; with configuration it is about 70 frames each way, and each of them is struck once by each kind
of fault, but for frames that are all alike: those of the push, and comparisons of the clocks between the first and the
last, are struck by every third kind in turn, and of the pages of the dictionary, which a device tells once, the first,
one in the middle and the last. What costs a frame and not the run strikes three of a run, far apart.
"""

import os
import signal
import subprocess
import sys
import time
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
    DeviceRefusedError,
    GuardError,
    IncompatibleDeviceError,
    LawError,
    LinkLostError,
    RigError,
    StoppedError,
)
from rig.core.sample import Phase, RowFlag
from rig.devices import framed
from rig.devices.fault_script import DeviceFault, Direction, Faults, FrameFault, Kind
from rig.devices.framed import EXCHANGES, STOP_FRAMES, FramedDevice
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_SIGNATURE
from rig.recording.reader import open_recording
from sim_backend.device import SimulatedDevice
from sim_backend.link import MemoryLink
from sim_backend.safety import IDLE_LIFETIME_S
from tests.conformance.census import children
from tests.conformance.started import started
from tests.conformance.trials import trial_on

LIFETIME_S = 0.005  # of a command at 1 kHz: five ticks
RAMP_S = 0.010
START = -0.015
TICKS = 16  # frames before the first sample and command
PUSH = range(TICKS + 7, TICKS + 31)  # those of ticks that differ in nothing but their numbers
CLOCKS = range(
    TICKS - EXCHANGES, TICKS - 2
)  # and those of comparisons of the clocks, before; as many come at the end

SHORT = config.override(
    config.with_realtime(presets.load("koul-compliant")),
    {
        "trial.duration_s": 0.03,
        "trial.release_s": 0.003,
        "homing.settle_s": 0.003,
        "verdict.tail_s": 0.01,
    },
)


class Bench:
    """One device with a script of faults, and one trial on it."""

    def __init__(
        self, directory: Path, faults: Faults | None = None, experiment: Any = SHORT, law: Any = None
    ) -> None:
        self.device = SimulatedDevice(config.rig_model(experiment), initial_position=START)
        self.link = MemoryLink(self.device, faults or Faults())
        self.path = directory / "trial.rigcap"
        self.experiment = experiment
        self.law = law
        self.error: RigError | None = None

    def run(self) -> "Bench":
        request = partial(
            trial_on,
            experiment=self.experiment,
            recording=self.path,
            verified=True,
            seed=0,
            law=self.law,
            sealed=False,
        )
        try:
            with FramedDevice(self.link) as device:
                request(device)
        except RigError as error:
            self.error = error
        return self

    def recording(self) -> Any:
        return open_recording(self.path)

    def check_ended_safely(self) -> None:
        """Zero effort within lifetime and ramp, and a recording, if one was begun, that reads."""
        self.link.elapse(LIFETIME_S + RAMP_S + 0.002)
        assert self.device.current == 0
        if self.device.connection.state in (State.ARMED, State.RUNNING):  # nobody ever moved anything
            self.link.elapse(IDLE_LIFETIME_S)
            assert self.device.current == 0
        assert self.device.connection.state not in (State.ARMED, State.RUNNING)
        if self.path.exists():
            recording = self.recording()
            assert recording.complete
            assert not recording.lost
            assert recording.trailer["counters"]["ticks"] == len(recording.rows)


def frames_of(directory: Any) -> Any:
    """Frames of an undisturbed run, each way."""
    bench = Bench(directory).run()
    assert bench.error is None
    sent = dict(bench.link.line.frames)
    bench.check_ended_safely()
    return sent


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The same for a host that has not met the device, and asks for its dictionary first."""
    framed._dictionaries.clear()
    return frames_of(tmp_path_factory.mktemp("first"))


@pytest.fixture(scope="module")
def frames(pages: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Frames of an undisturbed run, each way: which of them carry samples and commands."""
    clean = tmp_path_factory.mktemp("clean")
    sent = frames_of(clean)
    phases = open_recording(clean / "trial.rigcap").rows["phase"]
    assert set(phases[PUSH.start - TICKS - 1 : PUSH.stop - TICKS + 1]) == {Phase.TRIAL}
    assert all(40 < count <= 100 for count in sent.values())
    assert all(pages[direction] > sent[direction] + 50 for direction in Direction)
    return sent


@pytest.mark.parametrize("direction", Direction)
@pytest.mark.parametrize("kind", Kind)
def test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording(
    kind: Any, direction: Any, frames: Any, tmp_path: Path
) -> None:
    turn, count = list(Kind).index(kind) % 3, frames[direction]
    alike = {*PUSH, *CLOCKS, *range(count - EXCHANGES + 1, count - 1)}
    chosen = [frame for frame in range(count) if frame not in alike or frame % 3 == turn]
    if kind in (Kind.SILENCE, Kind.UNPLUG):
        finished = sum(struck(kind, direction, [frame], tmp_path) for frame in chosen)
        last_words = (
            2 * STOP_FRAMES + 5 + EXCHANGES
        )  # stops, disarming and its repeats, clocks compared at rest
        assert finished <= last_words + 1000 * (LIFETIME_S + RAMP_S) + 1, (
            "the watchdog ends every longer silence"
        )
        return
    # What is repeated shifts the numbers of all that follow: of frames that are answered, one to a run.
    answered = [[frame] for frame in chosen if frame < TICKS]
    rest = chosen[len(answered) :]
    runs = len(rest) // 3 + 1
    for some in answered + [rest[first::runs] for first in range(runs)]:
        assert struck(kind, direction, some, tmp_path), (
            "one bad frame is a counted loss, never the end of a run"
        )


@pytest.mark.parametrize("direction", Direction)
@pytest.mark.parametrize("kind", Kind)
def test_a_fault_at_a_page_of_the_dictionary_is_asked_again_or_ends_before_anything_moves(
    kind: Any, direction: Any, pages: Any, frames: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    last = pages[direction] - frames[direction]
    for page in (0, 1, last // 2, last - 1, last):
        monkeypatch.setattr(framed, "_dictionaries", {})
        finished = struck(kind, direction, [page], tmp_path)
        assert finished == (kind not in (Kind.SILENCE, Kind.UNPLUG)), page


def struck(kind: Any, direction: Any, frames: list[int], directory: Any) -> bool:
    """Strike frames of a run, check how it ended, and return whether it finished."""
    place = directory / str(frames[0])
    place.mkdir()
    faults = [FrameFault(kind=kind, direction=direction, frame=n, byte=n, bit=n % 8) for n in frames]
    bench = Bench(place, Faults(frames=tuple(faults))).run()
    assert bench.link.line.acted[kind] == len(frames), frames
    assert bench.error is None or isinstance(
        bench.error, LinkLostError | DeviceRefusedError | IncompatibleDeviceError
    ), (frames, bench.error)
    assert bench.error is None or bench.error.remedy, bench.error
    bench.check_ended_safely()
    return bench.error is None


def sample_frame(frames: Any) -> int:
    """A frame in the middle of the push."""
    return frames[Direction.TO_HOST] - 20


@pytest.mark.parametrize(
    ("kind", "counter"),
    [
        (Kind.DROP, "lost"),
        (Kind.CORRUPT, "bad_frames"),
        (Kind.TRUNCATE, "bad_frames"),
        (Kind.DUPLICATE, "duplicated"),
        (Kind.REORDER, "reordered"),
    ],
)
def test_each_kind_of_loss_of_a_sample_is_counted_and_flagged(
    kind: Any, counter: str, frames: Any, tmp_path: Path
) -> None:
    fault = FrameFault(kind=kind, direction=Direction.TO_HOST, frame=sample_frame(frames), byte=5, bit=3)
    bench = Bench(tmp_path, Faults(frames=(fault,))).run()
    assert bench.error is None
    rows, counters = bench.recording().rows, bench.recording().trailer["counters"]
    assert counters[counter] == 1
    gaps = int(np.count_nonzero(rows["flags"] & int(RowFlag.GAP)))
    assert gaps == (0 if kind is Kind.DUPLICATE else 1)
    assert counters["lost"] == int((rows["elapsed_ticks"] - 1).sum())
    np.testing.assert_array_equal(np.diff(rows["sample_index"]), rows["elapsed_ticks"][1:])


def test_silence_of_the_host_ramps_the_effort_down_and_latches(tmp_path: Path, frames: Any) -> None:
    fault = FrameFault(
        kind=Kind.SILENCE, direction=Direction.TO_DEVICE, frame=frames[Direction.TO_DEVICE] - 30 - EXCHANGES
    )
    bench = Bench(tmp_path, Faults(frames=(fault,))).run()
    assert isinstance(bench.error, DeviceFaultError | LinkLostError)
    assert "silent" in str(bench.error)
    assert bench.device.fault == Fault.LINK_LOST
    applied = np.abs(bench.recording().rows["effort_applied"])
    start = int(np.argmax(bench.recording().rows["command_age"] > 5)) or len(applied)
    assert (np.diff(applied[start:]) <= 1e-12).all(), "the ramp only falls"
    bench.check_ended_safely()


@pytest.mark.parametrize("tick", range(0, 36, 3))
@pytest.mark.parametrize("fault", [Fault.ENCODER, Fault.EMERGENCY_STOP, Fault.OVER_CURRENT])
def test_a_device_fault_cuts_at_the_next_tick_and_is_told_with_its_remedy(
    fault: Any, tick: int, tmp_path: Path
) -> None:
    bench = Bench(tmp_path, Faults(device=(DeviceFault(tick, fault),))).run()
    bench.check_ended_safely()
    assert isinstance(bench.error, DeviceFaultError | DeviceRefusedError)
    assert bench.error.remedy
    if isinstance(bench.error, DeviceFaultError):
        assert fault.text in bench.error.message
        rows = bench.error.rows
        assert rows["fault"][-1] == fault
        assert rows["effort_applied"][-1] == 0.0
        assert rows["current_sent"][-1] == 0
        assert bench.recording().trailer["fault"]["name"] == fault.name
        assert len(bench.recording().trailer["fault"]["entries"]) >= tick - 1


@kernel(LAW_SIGNATURE)
def gives_nan(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[1] += 1.0
    return np.nan if state[1] > 15.0 else 0.0


@kernel(LAW_SIGNATURE)
def gives_infinity(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[1] += 1.0
    return np.inf if state[1] > 15.0 else 0.0


@kernel(LAW_SIGNATURE)
def raises(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[1] += 1.0
    if state[1] > 15.0:
        raise ValueError("too deep for me")
    return 0.0


@pytest.mark.parametrize("function", [gives_nan, gives_infinity])
def test_a_law_that_is_not_finite_ends_the_run_with_zero(function: Any, tmp_path: Path) -> None:
    law = Law("bad", "for this test", function, 2, lambda wall: [])
    bench = Bench(tmp_path, law=law).run()
    assert isinstance(bench.error, LawError)
    last = bench.recording().rows[-1]
    assert last["flags"] & int(RowFlag.NONFINITE)
    assert last["current_sent"] == 0
    assert not np.isfinite(last["effort_wanted"])
    bench.check_ended_safely()


def test_an_exception_in_a_users_law_ends_the_run_with_zero_and_is_named(tmp_path: Path) -> None:
    law = Law("bad", "for this test", raises, 2, lambda wall: [])
    bench = Bench(tmp_path, law=law).run()
    assert isinstance(bench.error, LawError)
    assert "too deep for me" in str(bench.error)
    assert isinstance(bench.error.__cause__, ValueError)
    assert len(bench.recording().rows) > 10
    assert bench.recording().trailer["reason"] == "law_raised"
    bench.check_ended_safely()


def test_leaving_the_window_ends_the_run_with_zero(tmp_path: Path) -> None:
    narrow = config.override(
        SHORT, {"rig.limits.position_maximum": 0.0005, "wall.stiffness": 60.0, "trial.duration_s": 0.2}
    )
    bench = Bench(tmp_path, experiment=narrow).run()
    assert isinstance(bench.error, GuardError | DeviceFaultError)
    bench.check_ended_safely()


def test_a_start_out_of_reach_is_given_up(tmp_path: Path) -> None:
    stuck = config.override(
        SHORT, {"rig.mechanics.link_coulomb": 0.2, "homing.timeout_s": 0.05, "trial.start": -0.02}
    )
    bench = Bench(tmp_path, experiment=stuck).run()
    assert isinstance(bench.error, GuardError)
    assert "homing" in bench.error.remedy
    bench.check_ended_safely()


@pytest.mark.signals
def test_ctrl_c_stops_within_a_tick_and_leaves_a_whole_recording(tmp_path: Path) -> None:
    bench = Bench(tmp_path, experiment=config.override(SHORT, {"trial.duration_s": 60.0}))
    seen = []

    def interrupt(ticks: Any, phase: Any) -> None:
        if ticks > 100 and not seen:
            seen.append(ticks)
            signal.raise_signal(signal.SIGINT)

    request = partial(
        trial_on,
        experiment=bench.experiment,
        recording=bench.path,
        verified=True,
        seed=0,
        progress=interrupt,
        sealed=False,
    )
    with pytest.raises(StoppedError) as caught, FramedDevice(bench.link) as device:
        request(device)
    assert seen
    assert caught.value.recording == bench.path
    assert bench.recording().trailer["reason"] == "stopped"
    assert bench.recording().rows["phase"][-1] == Phase.TRIAL
    bench.check_ended_safely()


HOST = """
import sys
from pathlib import Path
from rig import config
from rig.config import presets
from rig.devices import open_device
from tests.conformance.trials import trial_on
x = config.override(config.with_realtime(presets.load("koul-compliant")), {"trial.duration_s": 30.0})
with open_device(sys.argv[1]) as device:
    trial_on(device, experiment=x, recording=Path(sys.argv[2]), verified=True, seed=0)
"""


def test_kill_minus_nine_of_the_host_leaves_a_device_at_zero_and_a_readable_recording(tmp_path: Path) -> None:
    """Over a real serial port, in real time. Also accepted: the host found the link lost before it could be killed."""
    from rig.devices import open_device  # noqa: PLC0415
    from rig.devices.local import serve_locally  # noqa: PLC0415

    path = tmp_path / "killed.rigcap"
    with (
        serve_locally("sim://", config.rig_model(presets.load("koul-compliant"))) as url,
        started(sys.executable, "-c", HOST, url, path, stderr=subprocess.PIPE) as host,
    ):
        deadline = time.monotonic() + 60.0
        while host.poll() is None and time.monotonic() < deadline:
            if path.exists() and path.stat().st_size > 200_000:
                break
            time.sleep(0.05)
        host.send_signal(signal.SIGKILL)
        _, complaint = host.communicate(timeout=30.0)
        with open_device(url) as device:
            device.identify()
            time.sleep(LIFETIME_S + RAMP_S + 0.05)
            report = device.fault_report()
        if host.returncode == -signal.SIGKILL:
            assert report.name == "LINK_LOST"
            assert report.entries[-1]["current_commanded"] == 0 or report.entries
            recording = open_recording(path)
            assert not recording.complete
            assert len(recording.rows) > 500
        else:
            assert b"LinkLostError" in complaint or b"DeviceFaultError" in complaint
    assert os.path.exists(path) or os.path.exists(path.with_suffix(".parquet"))


def test_a_port_that_vanishes_in_mid_run_is_a_lost_link_with_a_whole_recording(tmp_path: Path) -> None:
    """The device process is killed: the pseudo-terminal hangs up, as a pulled USB plug does."""
    from rig.devices import open_device  # noqa: PLC0415
    from rig.devices.local import serve_locally  # noqa: PLC0415

    long = config.override(SHORT, {"trial.duration_s": 30.0, "verdict.tail_s": 0.4})
    path = tmp_path / "unplugged.rigcap"
    before = set(children())
    with serve_locally("sim://", config.rig_model(long)) as url, open_device(url) as device:
        (process,) = set(children()) - before

        def pull_the_plug(ticks: Any, phase: Any) -> None:
            if ticks > 200:
                os.kill(process, signal.SIGKILL)

        request = partial(
            trial_on,
            experiment=long,
            recording=path,
            verified=True,
            seed=0,
            progress=pull_the_plug,
            sealed=False,
        )
        with pytest.raises(LinkLostError) as caught:
            request(device)
    assert caught.value.remedy
    assert caught.value.statistics["ticks"] > 200
    assert len(caught.value.rows) == 100
    recording = open_recording(path)
    assert recording.complete
    assert recording.trailer["reason"] in {"link_closed", "link_silent"}
    assert len(recording.rows) == caught.value.statistics["ticks"]
