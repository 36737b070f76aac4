"""Faults in a trial of the shipped host, in virtual time: each time the effort ends at zero.

A short run is about forty ticks long and, with configuration, has about 70 frames each way. Each frame is struck once
by each kind of fault; of similar frames (those of the push, clock comparisons, dictionary pages) only a sample is.
Faults of the devices themselves: tests/firmware/test_firmware_faults.py.
"""

import signal
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.faults import Fault
from firmware_protocol.messages import STOP_FRAMES
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
    StoppedError,
)
from rig.core.sample import Phase, RowFlag
from rig.devices import framed
from rig.devices.fault_script import DeviceFault, Direction, FaultKind, Faults, FrameFault, Happening
from rig.devices.framed import EXCHANGES
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_SIGNATURE
from rig.recording.reader import open_recording
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from tests.conformance.firmware import need_compiler
from tests.conformance.struck import InMemory, StruckTrial
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import trial_on

LIFETIME_S = 0.005  # of a command: five ticks at 1 kHz
RAMP_S = 0.010
SUPERVISED_S = 0.020  # for how long a device with a law of its own follows it without its host
START = -0.015
TICKS = 16  # frames before the first sample and command
PUSH = range(TICKS + 7, TICKS + 31)  # those of ticks that differ in nothing but their numbers
CLOCKS = range(TICKS - EXCHANGES, TICKS - 2)  # comparisons of the clocks; as many come at the end
STRIKE = 900  # ticks of the link: in a long trial, some hundred behind the impact

SHORT = config.override(
    config.with_realtime(presets.load("koul-compliant")),
    {"trial.duration_s": 0.03, "trial.release_s": 0.003, "homing.settle_s": 0.003, "verdict.tail_s": 0.01},
)
LONG = config.override(
    presets.load("koul-compliant"),
    {
        "controller.position_rate": 2_000,
        "controller.velocity_rate": 500,
        "trial.duration_s": 1.0,
        "trial.release_s": 0.01,
        "homing.settle_s": 0.01,
        "verdict.tail_s": 0.2,
    },
)
# Far end → its device, and where the law runs.
FAR_ENDS: dict[str, tuple[Callable[..., Any], str]] = {
    "the firmware": (FirmwareDevice, "host"),
    "the law on the firmware": (FirmwareDevice, "device"),
    "the readable device": (SimulatedDevice, "host"),  # sends what the firmware sends
}
each_far_end = pytest.mark.parametrize("far_end", first_by_default(FAR_ENDS, 2))


class Bench(InMemory):
    """A simulated device with a script of faults, and the trial that runs on it."""

    def __init__(
        self,
        faults: Faults | None = None,
        experiment: Any = SHORT,
        far_end: str = "the readable device",
        **changes: Any,
    ) -> None:
        make, loop = FAR_ENDS[far_end]
        if make is FirmwareDevice:
            need_compiler()
        self.experiment = config.override(experiment, {"controller.loop": loop, **changes})
        device = make(config.rig_model(self.experiment), initial_position=START)
        lives_s = LIFETIME_S if loop == "host" else SUPERVISED_S
        super().__init__(device, faults, rest_s=lives_s + RAMP_S + 0.002)

    def run(self, directory: Path, **options: Any) -> StruckTrial:
        return StruckTrial(self, directory, self.experiment, **options)


def at(act: Callable[[Any], None], tick: int = STRIKE) -> Faults:
    return Faults(device=(Happening(tick, act),))


def count_frames(directory: Any) -> Any:
    """Return the number of frames of an undisturbed run in each direction."""
    bench = Bench()
    trial = bench.run(directory)
    sent = dict(bench.link.frames)
    trial.check()
    return sent


@pytest.fixture(scope="module")
def counts_with_dictionary(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the number of frames in each direction if the host must first read the device's dictionary."""
    framed._dictionaries.clear()
    return count_frames(tmp_path_factory.mktemp("first"))


@pytest.fixture(scope="module")
def frames(counts_with_dictionary: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the number of frames each way, and check which of them carry samples and commands."""
    clean = tmp_path_factory.mktemp("clean")
    sent = count_frames(clean)
    phases = open_recording(clean / "trial.rigcap").rows["phase"]
    assert set(phases[PUSH.start - TICKS - 1 : PUSH.stop - TICKS + 1]) == {Phase.TRIAL}
    assert all(40 < count <= 100 for count in sent.values())
    assert all(counts_with_dictionary[direction] > sent[direction] + 50 for direction in Direction)
    return sent


# By default every ninth frame, by one kind that ends a run and one that costs a frame.
DEFAULT = [(FaultKind.SILENCE, Direction.TO_DEVICE, 9), (FaultKind.CORRUPT, Direction.TO_HOST, 9)]
STRUCK = [*DEFAULT, *((kind, direction, 1) for kind, direction in product(FaultKind, Direction))]
strikes = pytest.mark.parametrize(("kind", "direction", "every"), first_by_default(STRUCK, len(DEFAULT)))


@strikes
def test_a_fault_at_any_frame_ends_with_zero_effort_and_a_readable_recording(
    kind: Any, direction: Any, every: int, frames: Any, tmp_path: Path
) -> None:
    turn, count = list(FaultKind).index(kind) % 3, frames[direction]
    alike = {*PUSH, *CLOCKS, *range(count - EXCHANGES + 1, count - 1)}
    chosen = [frame for frame in range(count) if frame not in alike or frame % 3 == turn][::every]
    if kind in (FaultKind.SILENCE, FaultKind.UNPLUG):
        finished = sum(strike_frames(kind, direction, [frame], tmp_path) for frame in chosen)
        closing = 2 * STOP_FRAMES + 5 + EXCHANGES  # stops, disarming and its repeats, clocks compared at rest
        assert finished <= closing + 1000 * (LIFETIME_S + RAMP_S) + 1, (
            "the watchdog ends every longer silence"
        )
        return
    # What is repeated shifts the numbers of all that follow: of frames that are answered, one to a run.
    answered = [[frame] for frame in chosen if frame < TICKS]
    rest = chosen[len(answered) :]
    runs = len(rest) // 3 + 1
    for some in answered + [rest[first::runs] for first in range(runs)]:
        assert strike_frames(kind, direction, some, tmp_path), (
            "one bad frame is a counted loss, never the end of a run"
        )


@strikes
def test_after_a_fault_at_a_page_of_the_dictionary_it_is_requested_again_or_nothing_moves(
    kind: Any,
    direction: Any,
    every: int,
    counts_with_dictionary: Any,
    frames: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    last = counts_with_dictionary[direction] - frames[direction]
    for page in (0, 1, last // 2, last - 1, last)[:: 2 if every > 1 else 1]:
        monkeypatch.setattr(framed, "_dictionaries", {})
        finished = strike_frames(kind, direction, [page], tmp_path)
        assert finished == (kind not in (FaultKind.SILENCE, FaultKind.UNPLUG)), page


def strike_frames(kind: Any, direction: Any, frames: list[int], directory: Any) -> bool:
    """Apply a fault to frames of a run, check how the run ended, and return True if it finished."""
    place = directory / str(frames[0])
    place.mkdir()
    faults = [FrameFault(kind=kind, direction=direction, frame=n, byte=n, bit=n % 8) for n in frames]
    bench = Bench(Faults(frames=tuple(faults)))
    trial = bench.run(place)
    assert bench.link.struck == len(frames), frames
    if trial.error is not None:
        trial.check(LinkLostError, DeviceRefusedError, IncompatibleDeviceError, replays=False)
        return False
    trial.check(replays=False)
    return True


def sample_frame(frames: Any) -> int:
    return frames[Direction.TO_HOST] - 20


@pytest.mark.parametrize(
    ("kind", "counter"),
    [
        (FaultKind.DROP, "lost"),
        (FaultKind.CORRUPT, "bad_frames"),
        (FaultKind.TRUNCATE, "bad_frames"),
        (FaultKind.DUPLICATE, "duplicated"),
        (FaultKind.REORDER, "reordered"),
    ],
)
def test_each_kind_of_loss_of_a_sample_is_counted_and_flagged(
    kind: Any, counter: str, frames: Any, tmp_path: Path
) -> None:
    fault = FrameFault(kind=kind, direction=Direction.TO_HOST, frame=sample_frame(frames), byte=5, bit=3)
    trial = Bench(Faults(frames=(fault,))).run(tmp_path).check()
    rows, counters = trial.rows, trial.counters
    assert counters[counter] == 1
    gaps = int(np.count_nonzero(rows["flags"] & int(RowFlag.GAP)))
    assert gaps == (0 if kind is FaultKind.DUPLICATE else 1)
    assert counters["lost"] == int((rows["elapsed_ticks"] - 1).sum())
    np.testing.assert_array_equal(np.diff(rows["sample_index"]), rows["elapsed_ticks"][1:])


@kernel(LAW_SIGNATURE)
def gives_nan(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[1] += 1.0
    return np.nan if state[1] > 15.0 else 0.0


@kernel(LAW_SIGNATURE)
def raises(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[1] += 1.0
    if state[1] > 15.0:
        raise ValueError("too deep for me")
    return 0.0


@pytest.mark.parametrize(("function", "reason"), [(gives_nan, "nonfinite"), (raises, "law_raised")])
def test_a_law_that_fails_ends_the_run_with_zero_and_is_named(
    function: Any, reason: str, tmp_path: Path
) -> None:
    trial = Bench().run(tmp_path, law=Law("bad", "for this test", function, 2, lambda wall: []))
    trial.check(LawError, replays=False)
    assert trial.recording.trailer["reason"] == reason
    last = trial.rows[-1]
    if reason == "nonfinite":
        assert last["flags"] & int(RowFlag.NONFINITE)
        assert last["current_sent"] == 0
        assert not np.isfinite(last["effort_wanted"])
    else:
        assert "too deep for me" in str(trial.error)
        assert isinstance(trial.error.__cause__, ValueError)  # type: ignore[union-attr]
        assert len(trial.rows) > 10


def test_a_start_out_of_reach_is_given_up(tmp_path: Path) -> None:
    stuck = {"rig.mechanics.link_coulomb": 0.2, "homing.timeout_s": 0.05, "trial.start": -0.02}
    trial = Bench(**stuck).run(tmp_path).check(GuardError)
    assert trial.error is not None
    assert "homing" in trial.error.remedy


@pytest.mark.signals
def test_ctrl_c_stops_within_a_tick_and_leaves_a_whole_recording(tmp_path: Path) -> None:
    seen = []

    def interrupt(ticks: Any, phase: Any) -> None:
        if ticks > 100 and not seen:
            seen.append(ticks)
            signal.raise_signal(signal.SIGINT)

    trial = Bench(**{"trial.duration_s": 60.0}).run(tmp_path, progress=interrupt).check(StoppedError)
    assert seen
    assert trial.error is not None
    assert trial.error.recording == trial.path
    assert trial.recording.trailer["reason"] == "stopped"
    assert trial.rows["phase"][-1] == Phase.TRIAL


# The second is no `Exception`: it leaves the wait for the loop at once.
@pytest.mark.parametrize("error", [ZeroDivisionError, SystemExit])
def test_an_exception_of_the_caller_ends_the_run_with_zero(
    error: type[BaseException], tmp_path: Path
) -> None:
    def break_down(ticks: Any, phase: Any) -> None:
        if ticks > 100:
            raise error

    bench, path = Bench(**{"trial.duration_s": 60.0}), tmp_path / "trial.rigcap"
    with bench.open() as device:
        with pytest.raises(error):
            trial_on(device, bench.experiment, path, progress=break_down, sealed=False)
        assert bench.device.current == 0, "before the device is closed"
    assert open_recording(path).rows["phase"][-1] == Phase.TRIAL


# ---------------------------------------------------------------------- silence of the host


@each_far_end
def test_silence_of_the_host_ramps_the_effort_down_and_latches(far_end: str, tmp_path: Path) -> None:
    silence = FrameFault(kind=FaultKind.SILENCE, direction=Direction.TO_DEVICE, tick=STRIKE)
    bench = Bench(Faults(frames=(silence,)), LONG, far_end)
    trial = bench.run(tmp_path).check(DeviceFaultError, LinkLostError)
    assert "no valid command arrived" in str(trial.error)
    assert bench.device.fault == Fault.LINK_LOST
    rows = trial.rows
    assert rows["current_sent"][-1] == 0
    if FAR_ENDS[far_end][1] == "host":  # else what fades is the law, whose effort follows the handle
        applied = np.abs(rows["effort_applied"])
        start = int(np.argmax(rows["command_age"] > 2_000 * LIFETIME_S)) or len(applied)
        assert (np.diff(applied[start:]) <= 1e-12).all(), "the ramp only falls"


# ---------------------------------------------------------------------- the device and its world


@each_far_end
@pytest.mark.parametrize("fault", first_by_default([Fault.ENCODER, Fault.EMERGENCY_STOP, Fault.OVER_CURRENT]))
def test_a_fault_of_the_device_at_any_tick_is_reported_with_every_sample_up_to_it(
    fault: Fault, far_end: str, tmp_path: Path
) -> None:
    for tick in (0, 4, 17, 33):
        place = tmp_path / str(tick)
        place.mkdir()
        trial = Bench(Faults(device=(DeviceFault(tick, fault),)), far_end=far_end).run(place)
        trial.check(DeviceFaultError, DeviceRefusedError)
        if not isinstance(trial.error, DeviceFaultError):
            continue  # it was found before anything moved
        assert fault.text in trial.error.message
        rows = trial.error.rows
        assert rows["fault"][-1] == fault
        assert not rows["fault"][:-1].any()
        assert (rows["elapsed_ticks"] == 1).all()
        assert rows["effort_applied"][-1] == 0.0
        assert trial.recording.trailer["fault"]["name"] == fault.name
        assert len(trial.recording.trailer["fault"]["entries"]) >= tick - 1


def slip(counts: int) -> Callable[[Any], None]:
    return lambda device: setattr(device.hardware, "slip", counts)


def push(effort: float) -> Callable[[Any], None]:
    return lambda device: setattr(device.hardware, "external_effort", effort)


CASES: dict[str, tuple[Callable[[Any], None], tuple[Fault, ...]]] = {
    "an encoder that jumps": (slip(1_500), (Fault.OVER_SPEED, Fault.BATCH_OVERFLOW)),
    "a short circuit": (lambda device: setattr(device.hardware, "leak", 32_767), (Fault.OVER_CURRENT,)),
    "the emergency stop": (lambda device: device.press_emergency_stop(), (Fault.EMERGENCY_STOP,)),
    "a late tick": (lambda device: device.inject_fault(Fault.TICK_OVERRUN), (Fault.TICK_OVERRUN,)),
}


@each_far_end
@pytest.mark.parametrize("name", first_by_default(CASES, 2))
def test_a_fault_in_the_wall_is_reported_with_its_remedy(name: str, far_end: str, tmp_path: Path) -> None:
    act, faults = CASES[name]
    bench = Bench(at(act), LONG, far_end)
    trial = bench.run(tmp_path).check(DeviceFaultError)
    assert trial.error is not None
    found = bench.device.fault or next(fault for fault in faults if fault.text in trial.error.message)
    assert found in faults
    assert found.text in trial.error.message
    rows = trial.rows
    assert rows["phase"][-2] == Phase.TRIAL
    in_rows = bench.experiment.controller.loop == "host"  # BATCH has no fault
    assert rows["fault"][-1] in (faults if in_rows else (Fault.NONE, *faults))
    assert rows["current_sent"][-1] == 0 or not in_rows
    assert trial.recording.trailer["fault"]["name"] in {fault.name for fault in faults}
    assert len(trial.recording.trailer["fault"]["entries"]) > 50, (
        "the ticks before it, as the device stored them"
    )


@each_far_end
@pytest.mark.parametrize("effort", [5.0, -1.0], ids=["a blow", "a pull"])
def test_a_handle_driven_beyond_its_limits_ends_the_run(effort: float, far_end: str, tmp_path: Path) -> None:
    """The law's guard or the device's monitor ends the run, whichever acts first."""
    bench = Bench(at(push(effort)), LONG, far_end, **{"rig.limits.position_minimum": -0.02})
    bench.run(tmp_path).check(GuardError, DeviceFaultError)


@pytest.mark.parametrize("far_end", list(FAR_ENDS)[:2])
def test_a_brown_out_in_mid_run_is_a_lost_link_and_then_a_named_reset(far_end: str, tmp_path: Path) -> None:
    bench = Bench(at(FirmwareDevice.brown_out), LONG, far_end)
    trial = bench.run(tmp_path).check(LinkLostError, DeviceFaultError, StoppedError)
    assert trial.rows["phase"][-1] == Phase.TRIAL
    assert len(bench.device.truth()) == 0, "no session since"
    with InMemory(bench.device, rest_s=0.0).open() as device:
        device.identify()
        report = device.fault_report()
        assert report.name == Fault.WATCHDOG_RESET.name
        assert report.remedy


@each_far_end
def test_a_released_switch_is_no_effort_and_no_fault_of_the_device(far_end: str, tmp_path: Path) -> None:
    bench = Bench(at(lambda device: device.hold_to_run(False)), LONG, far_end, **{"trial.kind": "human"})
    bench.device.hold_to_run(True)
    trial = bench.run(tmp_path)
    assert bench.device.fault is Fault.NONE
    trial.check(*([type(trial.error)] if trial.error else []))
    rows = trial.rows
    assert not rows["current_applied"][rows["sample_index"] > rows["sample_index"][0] + STRIKE + 5].any()


@each_far_end
def test_a_device_that_is_not_safe_does_not_arm(far_end: str, tmp_path: Path) -> None:
    bench = Bench(None, LONG, far_end)
    bench.device.press_emergency_stop()
    trial = bench.run(tmp_path).check(DeviceRefusedError)
    assert Fault.EMERGENCY_STOP.text in str(trial.error)
    assert not trial.path.exists()
    assert len(bench.device.truth()) == 0


def test_a_fault_of_an_earlier_run_is_cleared_and_reported(tmp_path: Path) -> None:
    bench = Bench()
    bench.device.inject_fault(Fault.OVER_SPEED)
    with bench.open() as device:
        results = tuple(hit(HitRequest(experiment=bench.experiment, device=device, output=tmp_path), admit))
    assert [result.cleared_fault for result in results] == [Fault.OVER_SPEED.text]
