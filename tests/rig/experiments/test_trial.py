"""One trial from configuring to sealing: its recording and the device after any rejection, error or interrupt."""

import errno
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig.devices
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.control.law import Law
from rig.core import errors
from rig.core.sample import ROW, Phase
from rig.devices.fault_script import DeviceFault, Direction, FaultKind, Faults, FrameFault, Happening
from rig.devices.framed import FaultReport, FramedDevice
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.experiments.trials import _trial as trials
from rig.experiments.trials._endings import ENDINGS, error_of
from rig.experiments.trials.judgement import experiment_of, judge
from rig.loop._contradictions import Contradiction
from rig.loop._run import COUNTERS, LoopEnd, LoopThread
from rig.loop.layout import EndReason
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_SIGNATURE
from rig.recording.files import free_name
from rig.recording.reader import open_recording
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.trials import trial_on

START = -0.015
SHORT = config.override(
    config.with_realtime(presets.load("koul-compliant")),
    {"trial.duration_s": 0.06, "trial.release_s": 0.003, "homing.settle_s": 0.003, "verdict.tail_s": 0.03},
)
LONG = config.override(SHORT, {"trial.duration_s": 600.0})


class Bench:
    def __init__(self, directory: Any, faults: Any = None) -> None:
        self.simulated = SimulatedDevice(config.rig_model(SHORT), initial_position=START)
        self.link = MemoryLink(self.simulated, faults)
        self.device = FramedDevice(self.link)
        self.directory = directory

    def run(self, experiment: Any = SHORT, name: str = "trial", **options: Any) -> Any:
        return trial_on(self.device, experiment, self.directory / f"{name}.rigcap", **options)

    def at_rest(self) -> Any:
        moving = (State.ARMED, State.RUNNING)
        return self.simulated.current == 0 and self.simulated.connection.state not in moving


def files(directory: Any) -> Any:
    return sorted(path.name for path in directory.iterdir())


def judge_trial(recording: Any) -> Any:
    return judge(recording, experiment_of(recording))


def judged_while_interrupted(recording: Any) -> Any:
    """Judge the recording after a Ctrl-C that arrives while it is sealed."""
    signal.raise_signal(signal.SIGINT)
    return judge_trial(recording)


# ---------------------------------------------------------------------- refused before anything moves


def test_a_device_that_does_not_arm_leaves_no_recording(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    with pytest.raises(errors.DeviceRefusedError, match="verified"):
        bench.run(verified=False)
    assert files(tmp_path) == []
    assert bench.at_rest()
    assert bench.run().reason == EndReason.FINISHED, "and the device is as good as before"


def test_a_recording_that_cannot_be_made_is_refused_before_arming(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "nowhere")
    with pytest.raises(errors.RecordingError, match="nowhere"):
        bench.run()
    bench = Bench(tmp_path)
    (tmp_path / "trial.rigcap").write_bytes(b"mine")
    with pytest.raises(errors.RecordingError, match="exists"):
        bench.run()
    assert (tmp_path / "trial.rigcap").read_bytes() == b"mine"
    assert bench.simulated.connection.state is State.CONFIGURED


# ---------------------------------------------------------------------- finished


def test_a_finished_trial_is_sealed_with_truth_verdict_and_counters(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    end = bench.run(judge=judge_trial, extra={"study": "seven"})
    assert end.recording == tmp_path / "trial.parquet"
    assert files(tmp_path) == ["trial.parquet"]
    recording = open_recording(end.recording)
    assert recording.complete
    assert recording.has_truth
    assert recording.trailer["reason"] == "finished"
    assert recording.trailer["error"] is None
    assert recording.trailer["counters"] == end.counters
    assert recording.trailer["verdict"]["kind"]
    assert recording.trailer["verdict_true"]["kind"]
    assert recording.header["extra"]["study"] == "seven"
    assert recording.header["identity"]["parameters"]["verified"] == 1
    assert recording.header["clocks"]["kind"] == "virtual"
    assert end.counters["ticks"] == len(recording)
    assert np.isfinite(recording.rows["position_true"]).all()
    assert bench.at_rest()


# ---------------------------------------------------------------------- ended early


@kernel(LAW_SIGNATURE)
def raises(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[1] += 1.0
    if state[1] > 10.0:
        raise ValueError("too deep for me")
    return 0.0


RAISING = Law("raising", "for this test", raises, 2, lambda wall: [])


@pytest.fixture(scope="module")
def frames_until_armed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    counted = []
    Bench(tmp_path_factory.mktemp("first"), Faults()).run()  # reads the dictionary: all others know it
    bench = Bench(tmp_path_factory.mktemp("counted"), Faults())

    def arm(original: Any = bench.device.arm) -> Any:
        session = original()
        counted.append(bench.link.line.frames[Direction.TO_HOST])
        return session

    bench.device.arm = arm
    bench.run()
    return counted[0]


@pytest.mark.parametrize(
    ("faults", "options", "error", "reason"),
    [
        (None, {"law": RAISING}, errors.LawError, "law_raised"),
        (Faults(device=(DeviceFault(40, Fault.ENCODER),)), {}, errors.DeviceFaultError, "device_fault"),
        (Faults(device=(DeviceFault(0, Fault.ENCODER),)), {}, errors.DeviceFaultError, "device_fault"),
        ((FaultKind.SILENCE, 40), {}, errors.LinkLostError, "link_silent"),
        ((FaultKind.SILENCE, 0), {}, errors.LinkLostError, "link_silent"),
        ((FaultKind.UNPLUG, 40), {}, errors.LinkLostError, "link_closed"),
    ],
    ids=["law", "fault", "fault at once", "silence", "silence before the first sample", "unplug"],
)
def test_an_early_end_leaves_a_sealed_judged_recording_that_the_error_names(
    faults: Any, options: Any, error: Any, reason: str, tmp_path: Path, frames_until_armed: Any
) -> None:
    if isinstance(faults, tuple):
        kind, frame = faults
        place = {"direction": Direction.TO_HOST, "frame": frames_until_armed + frame}
        faults = Faults(frames=(FrameFault(kind=kind, **place),))
    bench = Bench(tmp_path, faults)
    with pytest.raises(error) as caught:
        bench.run(judge=judge_trial, **options)
    recording = open_recording(caught.value.recording)
    assert recording.complete
    assert recording.trailer["reason"] == reason
    assert recording.trailer["error"] == str(caught.value)
    assert recording.trailer["verdict"]["kind"] == "invalid"
    assert files(tmp_path) == ["trial.parquet"]
    bench.link.elapse(0.03)
    assert bench.simulated.current == 0
    bench.link.elapse(1.0)  # a device that never got a command stays armed for so long
    assert bench.at_rest()
    if error is not errors.LinkLostError:
        assert bench.run(name="second").reason == EndReason.FINISHED


def test_an_exception_of_the_far_end_is_the_cause_of_a_lost_link(tmp_path: Path) -> None:
    bug = Happening(tick=40, act=lambda device: device.current / 0)
    with pytest.raises(errors.LinkLostError) as caught:
        Bench(tmp_path, Faults(device=(bug,))).run()
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert open_recording(caught.value.recording).trailer["reason"] == "link_closed"


def test_the_error_of_a_run_outlasts_that_of_sealing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise errors.RecordingError("no space left", remedy="free some space")

    monkeypatch.setattr(trials, "seal", full)
    bench = Bench(tmp_path, Faults(device=(DeviceFault(40, Fault.ENCODER),)))
    with pytest.raises(errors.DeviceFaultError) as caught:
        bench.run(name="faulty")
    assert caught.value.recording == tmp_path / "faulty.rigcap"
    assert "no space left" in "".join(caught.value.__notes__)
    assert open_recording(caught.value.recording).complete
    with pytest.raises(errors.RecordingError, match="no space"):
        bench.run(name="fine")


def test_the_error_of_an_early_end_has_the_messages_of_the_link(tmp_path: Path) -> None:
    """A problem of the link is often the reason for the early end."""
    bench = Bench(tmp_path)
    bench.link.messages = ["the port waits 16 ms. To fix it: ..."]
    with pytest.raises(errors.LawError) as caught:
        bench.run(law=RAISING)
    assert caught.value.messages == tuple(bench.link.messages)


def test_a_judge_that_fails_leaves_the_capture(tmp_path: Path) -> None:
    def wrong(recording: Any) -> None:
        raise errors.ConfigError("cannot be judged")

    bench = Bench(tmp_path)
    with pytest.raises(errors.ConfigError):
        bench.run(judge=wrong)
    assert open_recording(tmp_path / "trial.rigcap").complete
    assert bench.at_rest()


def test_an_exception_of_the_progress_brings_the_rig_to_rest(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    with pytest.raises(ZeroDivisionError) as caught, bench.device:
        bench.run(LONG, progress=lambda ticks, phase: 1 // (ticks == 0), judge=judge_trial)
    assert bench.at_rest()
    assert caught.value.recording == tmp_path / "trial.parquet"
    trailer = open_recording(caught.value.recording).trailer
    assert trailer["reason"] == "stopped"
    assert "ZeroDivisionError" in trailer["error"]
    assert trailer["verdict"]["kind"] == "invalid"


def test_a_late_error_of_the_progress_is_not_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The progress callback runs once more while the loop ends by itself."""
    bench = Bench(tmp_path)
    wait = LoopThread.wait

    def late(loop: Any, progress: Any = None) -> None:
        wait(loop)
        progress(1, Phase.DONE)

    def broken(ticks: Any, phase: Any) -> None:
        if ticks:
            raise errors.RigError("the console broke")

    monkeypatch.setattr(LoopThread, "wait", late)
    with pytest.raises(errors.RigError, match="the console broke") as caught:
        bench.run(progress=broken)
    trailer = open_recording(caught.value.recording).trailer
    assert trailer["reason"] == "finished"


# ---------------------------------------------------------------------- interrupted


def interrupting(numbers: Any, after: int = 50) -> Any:
    sent = []

    def progress(ticks: Any, phase: Any) -> None:
        if ticks > after and not sent:
            sent.append(ticks)
            for number in numbers:
                signal.raise_signal(number)

    return progress


def assert_stopped(bench: Any, caught: Any) -> None:
    assert caught.value.exit_code == 130
    recording = open_recording(caught.value.recording)
    assert recording.complete
    assert recording.trailer["reason"] == "stopped"
    assert bench.at_rest()


@pytest.mark.parametrize(
    "numbers",
    [[signal.SIGINT], [signal.SIGTERM], [signal.SIGINT, signal.SIGTERM, signal.SIGINT]],
    ids=["once", "term", "impatient"],
)
@pytest.mark.signals
def test_ctrl_c_however_often_leaves_a_whole_recording(numbers: Any, tmp_path: Path, handlers: None) -> None:
    bench = Bench(tmp_path)
    with pytest.raises(errors.StoppedError) as caught:
        bench.run(LONG, progress=interrupting(numbers))
    assert_stopped(bench, caught)
    assert f"stopped by {numbers[-1].name}; " in str(caught.value)


@pytest.fixture
def handlers() -> Iterator[Any]:
    """Let SIGTERM interrupt, as the command line does; check that a trial restores the handlers."""

    def interrupt(number: Any, frame: Any) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    expected = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    try:
        yield
        assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == expected
        assert not signal.pthread_sigmask(signal.SIG_BLOCK, [])
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize("place", ["finish", "end", "handover"])
@pytest.mark.signals
def test_a_second_ctrl_c_does_not_cut_short_what_the_first_began(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, handlers: None
) -> None:
    bench = Bench(tmp_path)
    original = getattr(LoopThread, place)

    def impatient(self: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return original(self)

    monkeypatch.setattr(LoopThread, place, impatient)
    with pytest.raises(errors.StoppedError) as caught:
        bench.run(LONG, progress=interrupting([signal.SIGINT]))
    assert_stopped(bench, caught)


@pytest.mark.parametrize(
    ("options", "reason"), [({}, "finished"), ({"law": RAISING}, "law_raised")], ids=["finished", "law"]
)
@pytest.mark.signals
def test_ctrl_c_in_sealing_is_not_lost(options: Any, reason: str, tmp_path: Path, handlers: None) -> None:
    """A Z-width map continues with the next wall after a guard stop, but not after Ctrl-C."""
    bench = Bench(tmp_path)
    with pytest.raises(errors.StoppedError) as caught:
        bench.run(judge=judged_while_interrupted, **options)
    assert caught.value.signal == signal.SIGINT
    recording = open_recording(caught.value.recording)
    assert recording.trailer["reason"] == reason
    assert recording.trailer["verdict"]
    assert files(tmp_path) == ["trial.parquet"]


@pytest.mark.signals
def test_ctrl_c_while_arming_moves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, handlers: None
) -> None:
    bench = Bench(tmp_path)
    original = bench.device.arm

    def interrupted() -> Any:
        signal.raise_signal(signal.SIGINT)
        return original()

    monkeypatch.setattr(bench.device, "arm", interrupted)
    with pytest.raises(errors.StoppedError) as caught:
        bench.run(LONG)
    assert_stopped(bench, caught)
    assert len(open_recording(caught.value.recording)) == 0


# ---------------------------------------------------------------------- endings in words


@pytest.mark.parametrize("reason", [reason for reason in EndReason if reason != EndReason.FINISHED])
def test_every_ending_is_an_error_with_words_and_a_remedy(reason: Any) -> None:
    counters = {**dict.fromkeys(COUNTERS, 0), "errno": errno.EIO}
    end = LoopEnd(reason, ValueError("{odd} braces"), counters, Contradiction.CLOCK.text)
    rows = np.zeros(3, ROW)
    url = "serial:///dev/tty{0}"
    fault = FaultReport(5, "ENCODER", "illegal {transition}", "check {cable}", 0, 0, [])
    for known in (fault, None):
        error = error_of(end, url, known, rows)
        assert isinstance(error, ENDINGS[reason][0])
        # EIO on a terminal: the cable was pulled.
        assert (type(error) is errors.UnpluggedError) == (reason == EndReason.LINK_CLOSED)
        assert error.message
        assert error.remedy or issubclass(type(error), errors.StoppedError)
        if isinstance(error, errors.LinkLostError):
            assert error.statistics == counters
            assert len(error.rows) == 3
    text = str(error_of(end, url, fault, rows))
    expected = {
        EndReason.LINK_CLOSED: [url, os.strerror(errno.EIO)],
        EndReason.LINK_SILENT: [url],
        EndReason.DEVICE_FAULT: ["illegal {transition}", "check {cable}"],
        EndReason.LAW_RAISED: ["{odd} braces"],
        EndReason.DEVICE_CONTRADICTS: [Contradiction.CLOCK.text],
    }
    for words in expected.get(reason, []):
        assert words in text


def test_a_run_that_the_device_ends_without_a_fault_is_an_error_with_a_remedy() -> None:
    end = LoopEnd(EndReason.DEVICE_FAULT, None, dict.fromkeys(COUNTERS, 0))
    error = error_of(end, "sim://", FaultReport(0, "NONE", "no fault", "", 0, 0, []), np.zeros(0, ROW))
    assert error is not None
    assert error.message == "device fault: it did not report which"
    assert error.remedy


def test_a_device_that_restarts_in_mid_run_is_not_only_silent(tmp_path: Path) -> None:
    faults = Faults(device=(Happening(tick=300, act=lambda device: device.reset()),))
    with pytest.raises(errors.DeviceFaultError, match="restarted during the run") as caught:
        Bench(tmp_path, faults).run(LONG)
    assert caught.value.end.reason == EndReason.DEVICE_RESTARTED
    assert open_recording(caught.value.recording).trailer["reason"] == "device_restarted"


# ---------------------------------------------------------------------- hit


def request_hit(directory: Any, **options: Any) -> Any:
    return HitRequest(**{"experiment": SHORT, "output": directory / "recordings", **options})


def test_a_hit_beyond_a_limit_is_refused_before_a_directory_is_made(tmp_path: Path) -> None:
    with pytest.raises(errors.PlanError, match="peak penetration"):
        list(hit(request_hit(tmp_path, changes={"rig.limits.position_maximum": 0.0001}), admit))
    with pytest.raises(errors.PlanError, match="device rate"):
        list(hit(request_hit(tmp_path, url="sim://?position_rate_maximum=500&position_rate_default=400", changes={
            "rig.limits.slew": 1e5}), admit))  # fmt: skip
    assert files(tmp_path) == []


def test_a_consumer_that_stops_closes_the_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = []
    original = rig.devices.open_device

    def remember(*arguments: Any) -> Any:
        opened.append(original(*arguments))
        return opened[-1]

    monkeypatch.setattr(rig.devices, "open_device", remember)
    results = hit(request_hit(tmp_path, changes={"trial.repeats": 5}), admit)
    next(results)
    results.close()
    with pytest.raises(errors.LinkLostError):
        opened[0].link.write(b"x")
    assert len(files(tmp_path / "recordings")) == 1


def test_a_real_device_moves_only_when_its_polarity_is_verified(tmp_path: Path, real: None) -> None:
    with pytest.raises(errors.ConfigError, match="is not verified") as caught:
        list(hit(request_hit(tmp_path), admit))
    assert "`verified`" in caught.value.remedy
    assert files(tmp_path) == []
    (result,) = hit(request_hit(tmp_path, verified=True), admit)
    assert result.recording.header["identity"]["simulated"] is False


def test_names_of_recordings_are_free(tmp_path: Path) -> None:
    first = free_name(tmp_path, "x")
    assert first == tmp_path / "x.rigcap"
    for number, ending in enumerate(("rigcap", "parquet", "png", "svg", "pdf"), start=2):
        (tmp_path / f"{'x' if number == 2 else f'x-{number - 1}'}.{ending}").touch()
        assert free_name(tmp_path, "x") == tmp_path / f"x-{number}.rigcap"
