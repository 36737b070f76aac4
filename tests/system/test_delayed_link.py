"""A link that delays frames, in virtual time at 1 kHz: no command drives the motor after its lifetime."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol import messages as m
from firmware_protocol.faults import Fault, LimitFlag
from firmware_protocol.framing import FrameSplitter
from firmware_protocol.packing import HEADER, LAYOUTS
from rig import config
from rig.config import presets
from rig.control.verdict import Kind as Verdict
from rig.core.errors import DeviceFaultError, LinkLostError, RigError
from rig.devices.fault_script import Direction, FaultKind, Faults, FrameFault
from rig.devices.framed import FramedDevice
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit, left_by
from rig.recording.reader import open_recording
from sim_backend.board import device as readable
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.ends.link import MemoryLink
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import trial_on

LIFETIME, RAMP = 5, 10  # ticks
LONGEST = 40  # delay
IN_THE_WALL = 49  # command of a run that is sent when the handle presses into the wall
START = -0.015
EXPERIMENT = config.override(
    config.with_realtime(presets.load("koul-compliant")),
    {
        "wall.stiffness": 20.0,
        "trial.duration_s": 0.08,
        "trial.release_s": 0.003,
        "homing.settle_s": 0.003,
        "verdict.tail_s": 0.01,
    },
)
MODEL = config.rig_model(EXPERIMENT)
FRAMES = 60  # that are late: all of a run, and little of the conversation behind it
Delays = Callable[[int], int]  # frame behind the first that is late → ticks


def steady(delay: int) -> Delays:
    return lambda frame: delay


def ramp(delay: int) -> Delays:
    """Return delays of a buffer that fills slowly: the device still receives a frame in most ticks."""
    return lambda frame: min(frame // 2, delay)


def once(delay: int) -> Delays:
    """Return delays in which the first frame waits, blocks those behind it, and all then arrive at once."""
    return lambda frame: delay if frame == 0 else 0


@dataclass
class Run:
    """A device behind a link that delays frames from one command on, with a log of commands and STATEs."""

    link: MemoryLink
    delays: Delays
    first: int  # number of that command
    directions: tuple[Direction, ...]
    commands: list[tuple[int, int, int]] = field(default_factory=list)  # tick, sequence, current
    states: list[tuple[int, m.State]] = field(default_factory=list)  # of the session, with their ticks
    frames: list[bytes] = field(default_factory=list)  # the same from their sequence on
    error: RigError | None = None
    recording: Any = None

    def listen(self) -> None:
        assert self.link.line is not None
        line, send = self.link.line, self.link.line.send

        def record(direction: Direction, data: bytes, tick: int) -> None:
            for raw in FrameSplitter().feed(data):
                _, type_id, _, session, sequence = HEADER.unpack_from(raw)
                message = LAYOUTS[type_id].unpack(raw)
                if isinstance(message, m.Command):
                    if len(self.commands) == self.first:
                        line.add(self._faults(line.frames))
                    self.commands.append((tick, sequence, message.current))
                elif isinstance(message, m.State) and session:
                    self.states.append((tick, message))
                    self.frames.append(raw[4:])
            send(direction, data, tick)

        line.send = record  # type: ignore[method-assign]

    def _faults(self, begin: Mapping[Direction, int]) -> Iterator[FrameFault]:
        for direction, frame in product(self.directions, range(FRAMES)):
            ticks = self.delays(frame)
            yield FrameFault(
                kind=FaultKind.DELAY, direction=direction, frame=begin[direction] + frame, ticks=ticks
            )

    @property
    def onset(self) -> int:
        return self.commands[self.first][0]

    def flagged(self) -> int:
        """Return the number of STATEs with the flag of a command that was too old."""
        return sum(bool(state.limits & LimitFlag.COMMAND_TOO_OLD) for _, state in self.states)

    def assert_link_delayed(self) -> None:
        assert isinstance(self.error, LinkLostError)
        assert "hub" in self.error.remedy
        assert self.recording.trailer["reason"] == "link_delayed"


def late_run(
    delays: Delays,
    make: Callable[..., Any] = SimulatedDevice,
    *,
    first: int = IN_THE_WALL,
    directions: tuple[Direction, ...] = (Direction.TO_DEVICE,),
) -> Run:
    run = Run(MemoryLink(make(MODEL, initial_position=START), Faults()), delays, first, directions)
    run.listen()
    return run


def ran(directory: Path, delays: Delays, make: Callable[..., Any] = SimulatedDevice, **options: Any) -> Run:
    run = late_run(delays, make, **options)
    path = directory / f"{make.__name__}.rigcap"
    path.unlink(missing_ok=True)
    try:
        with FramedDevice(run.link) as device:
            trial_on(device, EXPERIMENT, path, sealed=False)
    except RigError as error:
        run.error = error
    run.recording = open_recording(path)
    return run


@pytest.fixture
def no_age_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the device accept each command, however old."""
    monkeypatch.setattr(readable, "is_too_old", lambda *command: False)


@pytest.mark.parametrize("delay", [0, 1, LIFETIME])
def test_up_to_a_lifetime_the_device_takes_each_command(
    delay: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, core = (ran(tmp_path, steady(delay), make) for make in (SimulatedDevice, FirmwareDevice))
    assert run.error is core.error is None
    monkeypatch.setattr(readable, "is_too_old", lambda *command: False)
    assert run.frames == core.frames == ran(tmp_path, steady(delay)).frames


@pytest.mark.parametrize(
    "delay",
    first_by_default([LIFETIME + 1, LONGEST, LIFETIME + 2, LIFETIME + RAMP - 1, LIFETIME + RAMP, 25], 2),
)
def test_a_command_beyond_its_lifetime_drives_nothing_and_the_effort_ramps_to_zero(
    delay: int, tmp_path: Path
) -> None:
    run, core = (ran(tmp_path, steady(delay), make) for make in (SimulatedDevice, FirmwareDevice))
    assert core.frames == run.frames
    before = run.commands[: run.first]
    commanded = max(abs(current) for _, _, current in before[-LIFETIME:])
    assert commanded > 100, "in the wall"
    after = [(tick - run.onset, state) for tick, state in run.states if tick > run.onset]
    driven = [abs(state.current_commanded) for _, state in after]
    assert max(driven) <= commanded
    assert {state.command_sequence for _, state in after if state.current_commanded} == {before[-1][1]}
    assert driven[LIFETIME - 1 :] == sorted(driven[LIFETIME - 1 :], reverse=True), "the ramp only falls"
    assert not any(state.current_commanded for passed, state in after if passed >= LIFETIME + RAMP)
    if delay < LIFETIME + RAMP - 1:
        run.assert_link_delayed()
    else:
        assert isinstance(run.error, DeviceFaultError), "nothing at all came until the end"
        assert run.link.device.fault is Fault.NONE
        assert Fault.LINK_LOST.text in run.error.message
        assert "hub" in run.error.remedy


@pytest.mark.parametrize("make", [SimulatedDevice, FirmwareDevice])
def test_a_buffer_that_fills_slowly_drives_no_longer_than_a_lifetime(make: Any, tmp_path: Path) -> None:
    run = ran(tmp_path, ramp(LONGEST), make)
    run.assert_link_delayed()
    late = 2 * (LIFETIME + 1)  # frames, until one is late by more than a lifetime
    newest = run.commands[run.first + late - 1]
    assert all(state.command_sequence <= newest[1] for _, state in run.states if state.current_commanded != 0)
    ended = newest[0] + LIFETIME + LIFETIME + RAMP  # under way, alive, fading
    assert not any(state.current_commanded for tick, state in run.states if tick >= ended)


@pytest.mark.parametrize("delay", [LIFETIME + 1, LONGEST])
def test_a_link_late_from_the_first_command_on_never_moves_the_motor(delay: int, tmp_path: Path) -> None:
    run = ran(tmp_path, steady(delay), first=0)
    assert not any(state.current_commanded for _, state in run.states)
    run.assert_link_delayed()
    assert len(run.recording.rows) <= delay + LIFETIME + 2, "long before a silent host's half second"


@pytest.mark.usefixtures("no_age_check")
@pytest.mark.parametrize(
    ("delays", "directions"),
    [
        (steady(6), (Direction.TO_DEVICE,)),
        (steady(12), tuple(Direction)),
        (ramp(8), (Direction.TO_HOST,)),
        (ramp(LONGEST), (Direction.TO_DEVICE,)),
    ],
    ids=["6", "12", "up to 8", "up to 40"],
)
def test_the_host_ends_the_run_where_the_device_checks_no_age(
    delays: Delays, directions: tuple[Direction, ...], tmp_path: Path
) -> None:
    run = ran(tmp_path, delays, directions=directions)
    run.assert_link_delayed()
    assert run.flagged() == 0
    assert run.recording.rows["effort_sent"][-1] == 0.0
    run.link.elapse(1e-3 * (LIFETIME + RAMP + LONGEST))
    assert run.link.device.current == 0


@pytest.mark.usefixtures("no_age_check")
@pytest.mark.parametrize("delay", [LIFETIME + 1, LONGEST])
def test_the_host_needs_a_lifetime_of_late_commands(delay: int, tmp_path: Path) -> None:
    """The first late command becomes active after the delay and appears in a STATE one sample later."""
    run = ran(tmp_path, steady(delay), first=0)
    run.assert_link_delayed()
    assert len(run.recording.rows) == delay + 2 + LIFETIME


@pytest.mark.parametrize("looks", [True, False])
@pytest.mark.parametrize("delay", [4, 8])
def test_late_commands_with_one_in_time_behind_them_end_nothing(
    looks: bool, delay: int, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if not looks:
        request.getfixturevalue("no_age_check")
    run = ran(tmp_path, once(delay))
    assert run.error is None
    assert run.flagged() == (looks and delay > LIFETIME)


def test_a_silence_long_after_a_late_command_is_a_silence(tmp_path: Path) -> None:
    run = ran(tmp_path, lambda frame: 8 if frame == 0 else LONGEST if frame > 15 else 0)
    assert run.flagged() == 1
    assert isinstance(run.error, DeviceFaultError)
    assert run.recording.trailer["reason"] == "device_fault"


def test_the_verdict_of_a_delayed_hit_is_invalid(tmp_path: Path) -> None:
    run = late_run(steady(8))
    with FramedDevice(run.link) as device, pytest.raises(LinkLostError) as caught:
        list(hit(HitRequest(experiment=EXPERIMENT, device=device, output=tmp_path), admit))
    left = left_by(caught.value)
    assert left is not None
    assert left.judgement.verdict.kind is Verdict.INVALID
