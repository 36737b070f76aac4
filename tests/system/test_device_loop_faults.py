"""The law on the device, the firmware itself as the far end: what can break on the way breaks, and no row is wrong.

In virtual time, over the true frames, with the shipped loop. What the device does depends on its own samples alone, so
a run whose frames to the host suffer must show the same samples as an undisturbed one, with gaps.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numba
import numpy as np
import pytest

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig import config
from rig.cli import run
from rig.config import presets
from rig.core.errors import DeviceFaultError, LinkLostError, RigError, StoppedError
from rig.core.sample import Phase
from rig.devices.fault_script import DeviceFault, Direction, Faults, FrameFault, Kind
from rig.devices.framed import FramedDevice
from rig.experiments.replay import replay
from rig.recording.reader import open_recording
from rig.recording.seal import seal
from sim_backend.firmware import FirmwareDevice
from sim_backend.firmware_library import FIRMWARE
from sim_backend.link import MemoryLink
from tests.conformance.trials import trial_on

RATE = 5000
START = -0.015
EVERY = 4  # of the frames: each kind strikes others
SHORT = config.override(
    presets.load("koul-compliant"),
    {
        "controller.loop": "device",
        "controller.position_rate": RATE,
        "controller.velocity_rate": 1000,
        "controller.estimator": "fdm-butterworth-fixed",
        "trial.duration_s": 0.06,
        "trial.release_s": 0.01,
        "homing.settle_s": 0.005,
        "verdict.tail_s": 0.01,
    },
)


@pytest.fixture(scope="module", autouse=True)
def _has_compiler() -> None:
    try:
        FIRMWARE.compiler()
    except RigError:
        pytest.skip("no C compiler is installed (package gcc)")


class Bench:
    """One device with a script of faults, and one trial on it."""

    def __init__(
        self, directory: Path, faults: Faults | None = None, experiment: config.Experiment = SHORT
    ) -> None:
        self.device = FirmwareDevice(config.rig_model(experiment), initial_position=START)
        self.link = MemoryLink(self.device, faults or Faults())  # type: ignore[arg-type]
        self.path = directory / "trial.rigcap"
        self.experiment = experiment
        self.error: RigError | None = None
        self.messages: tuple[str, ...] = ()

    def run(self) -> Bench:
        request = partial(
            trial_on, experiment=self.experiment, recording=self.path, verified=True, seed=0, sealed=False
        )
        try:
            with FramedDevice(self.link) as device:
                self.messages = request(device).messages
        except RigError as error:
            self.error, self.messages = error, tuple(error.messages)
        return self

    @property
    def rows(self) -> np.ndarray:
        return open_recording(self.path).rows

    def check_ended_safely(self) -> None:
        """Zero effort within lifetime and ramp, and a recording, if one was begun, that reads and replays."""
        self.link.elapse(0.05)
        assert self.device.current == 0
        if State(self.device.core.status.state) in (State.ARMED, State.RUNNING):  # nobody ever moved anything
            self.link.elapse(0.6)
            assert self.device.current == 0
        assert State(self.device.core.status.state) not in (State.ARMED, State.RUNNING)
        if self.path.exists():
            recording = open_recording(self.path)
            assert recording.complete
            assert not recording.lost
            assert recording.trailer is not None
            assert recording.trailer["counters"]["ticks"] == len(recording.rows)
            assert replay(recording).exact


class Clean:
    """An undisturbed run: its samples, and which of its frames belong to the session."""

    def __init__(self, directory: Path) -> None:
        first = directory / "first"
        first.mkdir()
        Bench(first).run()  # reads the dictionary: all others know it
        bench = Bench(directory)
        sent: list[int] = []
        link_write = bench.link.write

        def watched(data: bytes) -> None:
            link_write(data)
            if bench.device.core.status.session and not sent:
                sent.extend(bench.link.line.frames[way] for way in Direction)  # type: ignore[union-attr]

        bench.link.write = watched  # type: ignore[method-assign]
        bench.run()
        assert bench.error is None, bench.error
        assert bench.messages == ()
        self.first = dict(zip(Direction, sent, strict=True))
        self.frames = dict(bench.link.line.frames)  # type: ignore[union-attr]
        self.rows = bench.rows
        bench.check_ended_safely()


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Clean:
    return Clean(tmp_path_factory.mktemp("clean"))


def test_an_undisturbed_run_is_whole(clean: Clean) -> None:
    rows = clean.rows
    assert (rows["elapsed_ticks"] == 1).all()
    assert (np.diff(rows["sample_index"]) == 1).all()
    assert [int(phase) for phase in np.unique(rows["phase"])] == [1, 2, 3, 4, 5]
    assert (rows["phase"] == Phase.TRIAL).sum() == 0.06 * RATE
    assert np.abs(rows["current_applied"][1:] - rows["current_sent"][:-1]).max() <= 1


def test_timing_says_where_the_law_ran(
    clean: Clean, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = Bench(tmp_path).run()
    recording = seal(open_recording(bench.path))
    extra, wall = recording.header["extra"], recording.experiment["wall"]
    assert (extra["loop"], extra["arithmetic"]) == ("device", "fixed")
    assert extra["wall"] == pytest.approx({name: wall[name] for name in extra["wall"]}, rel=1e-6)
    assert recording.header["identity"]["parameters"]["law"] == 1
    assert (recording.rows["sampled_at"] != 0).any()
    assert not recording.rows["applied_at"].any()
    found = recording.trailer["device_host_agreement"]  # type: ignore[index]
    assert (found["holds"], found["beyond"]) == (True, 0)
    assert found["compared"] > 0.8 * len(recording.rows)
    assert run(["timing", str(recording.path), "--no-plot"]) == 0
    said = capsys.readouterr().out
    assert "law on the device" in said
    assert "sent to applied" not in said
    assert "unanswered" not in said


@pytest.mark.parametrize("kind", Kind)
def test_a_frame_to_the_host_that_suffers_is_a_counted_gap_and_never_a_wrong_row(
    kind: Kind, clean: Clean, tmp_path: Path
) -> None:
    """Frames from arming to the end, once each."""
    way, finished = Direction.TO_HOST, 0
    struck = range(clean.first[way] + list(Kind).index(kind) % EVERY, clean.frames[way], EVERY)
    true = dict(zip(clean.rows["sample_index"].tolist(), clean.rows["count"].tolist(), strict=True))
    applied = dict(
        zip(clean.rows["sample_index"].tolist(), clean.rows["current_applied"].tolist(), strict=True)
    )
    for frame in struck:
        place = tmp_path / str(frame)
        place.mkdir()
        fault = FrameFault(kind=kind, direction=way, frame=frame, byte=frame, bit=frame % 8)
        bench = Bench(place, Faults(frames=(fault,))).run()
        assert bench.error is None or isinstance(bench.error, LinkLostError | StoppedError), bench.error
        finished += bench.error is None
        rows = bench.rows
        for row in rows[["sample_index", "count", "current_applied"]].tolist():
            assert (true.get(row[0], row[1]), applied.get(row[0], row[2])) == row[1:], frame
        index = rows["sample_index"]
        assert rows["elapsed_ticks"][1:].tolist() == np.diff(index).tolist()
        lost = open_recording(bench.path).trailer["counters"]["lost"]  # type: ignore[index]
        assert lost == rows["elapsed_ticks"].sum() - len(rows)
        assert lost == 0 or kind not in (Kind.DUPLICATE, Kind.DELAY)
        bench.check_ended_safely()
    if kind not in (Kind.SILENCE, Kind.UNPLUG):
        assert finished == len(struck), "one bad frame is a counted loss, never the end of a run"


@pytest.mark.parametrize("kind", [kind for kind in Kind if kind not in (Kind.SILENCE, Kind.UNPLUG)])
def test_a_word_of_the_host_that_suffers_changes_no_sample(kind: Kind, clean: Clean, tmp_path: Path) -> None:
    """The device goes on for the lifetime of the last word that it understood: four times as long as they are apart."""
    way = Direction.TO_DEVICE
    for frame in range(clean.first[way] + 1, clean.frames[way], EVERY):
        place = tmp_path / str(frame)
        place.mkdir()
        fault = FrameFault(kind=kind, direction=way, frame=frame, byte=frame, bit=frame % 8)
        bench = Bench(place, Faults(frames=(fault,))).run()
        assert bench.error is None, (frame, bench.error)
        assert bench.rows["count"].tolist() == clean.rows["count"].tolist()
        bench.check_ended_safely()


def test_a_host_that_is_not_heard_leaves_the_device_to_ramp_down_and_say_so(
    clean: Clean, tmp_path: Path
) -> None:
    frame = clean.first[Direction.TO_DEVICE] + 8
    fault = FrameFault(kind=Kind.SILENCE, direction=Direction.TO_DEVICE, frame=frame)
    bench = Bench(tmp_path, Faults(frames=(fault,))).run()
    assert isinstance(bench.error, DeviceFaultError)
    assert Fault.LINK_LOST.text.partition(":")[0] in str(bench.error)
    assert bench.error.remedy
    rows = bench.rows
    assert rows["fault"][-1] == Fault.LINK_LOST
    assert rows["current_sent"][-1] == 0
    assert len(rows) < len(clean.rows)
    bench.check_ended_safely()


@pytest.mark.parametrize(
    "fault", [Fault.ENCODER, Fault.OVER_CURRENT, Fault.EMERGENCY_STOP, Fault.NON_FINITE, Fault.TICK_OVERRUN]
)
@pytest.mark.parametrize("late", [3, 40, 150])
def test_a_fault_of_the_device_is_told_with_every_sample_up_to_it(
    fault: Fault, late: int, clean: Clean, tmp_path: Path
) -> None:
    first = int(clean.rows["sample_index"][0])
    bench = Bench(tmp_path, Faults(device=(DeviceFault(first + late, fault),))).run()
    assert isinstance(bench.error, DeviceFaultError)
    assert fault.text in str(bench.error)
    assert bench.error.remedy
    rows = bench.rows
    assert rows["fault"][-1] == fault
    assert (rows["fault"][:-1] == 0).all()
    assert (rows["elapsed_ticks"] == 1).all()
    assert late - 3 <= len(rows) <= late + 3
    bench.check_ended_safely()
