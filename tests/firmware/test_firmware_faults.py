"""What goes wrong while the device renders the wall itself: zero effort in time, latched, and told at once.

The firmware with a rig behind it, at 20 kHz, in the middle of its trial; the host is a few lines that say SUPERVISE.
What the shipped host makes of the same faults is in tests/system/test_faults_of_a_device_loop.py.
"""

from __future__ import annotations

import ctypes
import random
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, LimitFlag, Status
from firmware_protocol.framing import encode_frame
from firmware_protocol.messages import DisarmFlag
from firmware_protocol.packing import pack
from firmware_protocol.parameters import BY_NAME
from firmware_protocol.transfer import set_parameters
from rig import config
from rig.config import controller, presets
from rig.core.model import RigModel
from rig.core.sample import Phase
from sim_backend.firmware import FirmwareDevice
from sim_backend.hardware import Hardware
from sim_backend.inner import COULOMB, COULOMB_LINK
from sim_backend.plant import PlantArguments
from tests.firmware.supervised import Supervisor

RATE = 20_000
SPEAK_EVERY = RATE // 200
LIFETIME = RATE * 20 // 1000  # ticks of a word of the host
RAMP = RATE * 10 // 1000
FOREVER_NS = 10**15
START = -0.015
LAG_TICKS = 200  # many times the lag of the amplifier: what is left of an effort then is nothing
EXPERIMENT = config.override(
    config.with_realtime(presets.load("koul-compliant")),
    {
        "controller.loop": "device",
        "controller.position_rate": RATE,
        "controller.velocity_rate": 2_000,
        "trial.duration_s": 30.0,
    },
)
MODEL = config.rig_model(EXPERIMENT)
PARAMETERS = controller.prepared(
    EXPERIMENT, current_quantum_a=MODEL.amplifier.current_quantum_a, reference_count=0, verified=True
).parameters


class Far(Supervisor):
    """The firmware in lock-step with a rig; `device.run` between two words of the host."""

    def __init__(self, library: ctypes.CDLL, model: RigModel = MODEL, **parameters: float) -> None:
        super().__init__()
        self.device = FirmwareDevice(model, library=library, initial_position=START)
        self.core = self.device.core
        self.begin(**{**PARAMETERS, "ramp_us": 10_000, "supervise_lifetime_us": 20_000, **parameters})

    def receive(self, data: bytes) -> bytes:
        return self.device.receive(data)

    def tick(self) -> None:
        self.take(self.device.tick())

    def command(self, mode: m.Mode = m.Mode.SUPERVISE, current: int = 0, lifetime_us: int = 20_000) -> None:
        """As ever; a fault of the device does not deter this host."""
        if self.host.state is State.FAULT:
            self.host.state = State.RUNNING
        super().command(mode, current, lifetime_us)

    def say(self, session: int) -> None:
        """SUPERVISE of a session, whatever this host's is."""
        words = m.Command(0, 20_000, int(m.Mode.SUPERVISE), 0, 0)
        self.receive(encode_frame(pack(words, session=session, sequence=1)))

    def pass_ticks(self, ticks: int) -> None:
        while ticks > 0:
            said, ran = self.device.run(FOREVER_NS, ticks)
            self.take(said)
            ticks -= ran

    def run(self, ticks: int) -> None:
        """Supervise for so many ticks."""
        for _ in range(0, ticks, SPEAK_EVERY):
            self.command()
            self.pass_ticks(SPEAK_EVERY)

    def into_the_wall(self) -> Far:
        """Up to where the wall pushes back."""
        while self.device.sample_index < RATE:
            self.run(SPEAK_EVERY)
            if self.device.hardware.count > 0 and self.device.current < -20:
                return self
        raise AssertionError("the handle does not come to the wall")

    def ticks_to_fault(self, most: int) -> int:
        """Supervise until a fault is latched; how many ticks that took."""
        for ticks in range(1, most + 1):
            if ticks % SPEAK_EVERY == 1:
                self.command()
            self.tick()
            if self.device.fault is not Fault.NONE:
                return ticks
        raise AssertionError("no fault")

    def check_at_rest(self, *faults: Fault) -> None:
        """FAULT, told in the tick that found it; no current now and later, whatever the host says."""
        device, told = self.device, next(state for state in self.states if state.fault)
        assert device.fault in faults
        assert (told.fault, told.state) == (device.fault, State.FAULT)
        assert told.sample_index >= device.sample_index - 1, "at once"
        assert (device.current, device.status.enabled) == (0, 0)
        samples = self.samples
        assert all(after.index - before.index == 1 for before, after in pairwise(samples))
        assert samples[-1].index >= told.sample_index - 1, "what led to it is told too"
        rows = len(device.truth())
        for _ in range(LAG_TICKS // SPEAK_EVERY):
            self.command()
            self.pass_ticks(SPEAK_EVERY)
            assert (device.current, device.status.enabled) == (0, 0)
        assert np.abs(device.truth()["effort_true"][rows + LAG_TICKS // 2 :]).max() < 1e-6
        assert device.fault in faults
        assert device.state is State.FAULT


def pushed(effort: float) -> Callable[[Far], None]:
    def act(far: Far) -> None:
        far.device.hardware.external_effort = effort

    return act


def let_go(far: Far) -> None:
    far.device.hardware.external_effort = 0.0


def slipped(counts: int) -> Callable[[Far], None]:
    def act(far: Far) -> None:
        far.device.hardware.slip += counts

    return act


def shorted(far: Far) -> None:
    far.device.hardware.leak = 32_767


@dataclass(frozen=True)
class Case:
    act: Callable[[Far], None]
    faults: tuple[Fault, ...]
    within: int  # ticks
    cleared_by: Callable[[Far], None] = let_go
    parameters: tuple[tuple[str, float], ...] = ()


CASES = {
    "an encoder that jumps": Case(slipped(2_000), (Fault.OVER_SPEED,), 1, slipped(-2_000)),
    "an encoder that jumps further than BATCH tells": Case(
        slipped(40_000), (Fault.OVER_SPEED, Fault.BATCH_OVERFLOW, Fault.POSITION_WINDOW), 1, slipped(-40_000)
    ),
    "an illegal transition": Case(lambda far: far.device.fail_encoder(), (Fault.ENCODER,), 1),
    "a short circuit": Case(
        shorted, (Fault.OVER_CURRENT,), 2, lambda far: setattr(far.device.hardware, "leak", 0)
    ),
    "a blow": Case(pushed(5.0), (Fault.OVER_SPEED, Fault.POSITION_WINDOW), RATE // 10),
    "a shove out of the window": Case(
        pushed(2.0), (Fault.POSITION_WINDOW,), RATE // 2, parameters=(("speed_limit", 4_000_000),)
    ),
    "the emergency stop": Case(
        lambda far: far.device.press_emergency_stop(),
        (Fault.EMERGENCY_STOP,),
        1,
        lambda far: far.device.press_emergency_stop(False),
    ),
    "a port that finds itself inconsistent": Case(
        lambda far: far.device.inject_fault(Fault.INTERNAL), (Fault.INTERNAL,), 1
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_a_fault_in_the_wall_is_zero_effort_latched_and_told(library: ctypes.CDLL, name: str) -> None:
    case = CASES[name]
    far = Far(library, **dict(case.parameters)).into_the_wall()
    assert far.states[-1].phase == Phase.TRIAL
    case.act(far)
    assert far.ticks_to_fault(case.within) <= case.within
    far.check_at_rest(*case.faults)
    if case.faults == (Fault.EMERGENCY_STOP,):
        refused = far.disarm(int(DisarmFlag.CLEAR_FAULT))
        assert (refused.status, refused.detail) == (Status.FAULT_PRESENT, Fault.EMERGENCY_STOP)
    case.cleared_by(far)
    assert far.disarm(int(DisarmFlag.CLEAR_FAULT)).status == Status.OK
    assert far.device.state in (State.CONFIGURED, State.IDENTIFIED)


def test_an_encoder_that_failed_must_be_homed_again(library: ctypes.CDLL) -> None:
    far = Far(library).into_the_wall()
    far.device.fail_encoder()
    far.ticks_to_fault(1)
    assert far.disarm(int(DisarmFlag.CLEAR_FAULT)).status == Status.OK
    assert far.arm().status == Status.NOT_HOMED


def jammed(plant: PlantArguments) -> PlantArguments:
    """The same plant under so much friction that it stands."""
    parameters = plant.parameters.copy()
    parameters[[COULOMB, COULOMB_LINK]] = 5.0
    return PlantArguments(**plant._asdict() | {"parameters": parameters})


def test_a_mechanism_that_jams_under_a_large_effort_is_a_runaway(library: ctypes.CDLL) -> None:
    far = Far(library, current_limit=1_000)
    far.run(RATE // 20)
    while far.device.current > -600:
        far.command()
        far.tick()
        assert far.device.sample_index < RATE
    hardware = far.device.hardware
    hardware._moving, hardware._handle = jammed(hardware._moving), 0
    far.ticks_to_fault(RATE)
    far.check_at_rest(Fault.RUNAWAY)


def test_a_motor_and_an_encoder_that_disagree_about_the_direction_are_stopped(library: ctypes.CDLL) -> None:
    """The homing servo itself drives the handle away, and finds no start."""
    far = Far(library)
    wrong = replace(MODEL, encoder=replace(MODEL.encoder, sign=-MODEL.encoder.sign))
    far.device.hardware = Hardware(wrong, RATE, seed=0, initial_position=START)
    far.ticks_to_fault(RATE)
    far.check_at_rest(Fault.RUNAWAY, Fault.OVER_SPEED, Fault.POSITION_WINDOW)


def test_the_speed_at_which_it_is_stopped_is_the_limit(library: ctypes.CDLL) -> None:
    far = Far(library).into_the_wall()
    pushed(5.0)(far)
    far.ticks_to_fault(RATE)
    counts = np.array([sample.count for sample in far.samples])
    over_5_ms = np.abs(counts[100:] - counts[:-100]) / 0.005
    limit = float(PARAMETERS["speed_limit"])
    if far.device.fault is Fault.OVER_SPEED:
        assert over_5_ms[-1] > limit
        assert over_5_ms[:-1].max() <= limit * 1.001 + 1 / 0.005


# ---------------------------------------------------------------------- the host


def test_a_silent_host_is_followed_for_its_lifetime_then_faded_out_then_lost(library: ctypes.CDLL) -> None:
    far, twin = (Far(library).into_the_wall() for _ in range(2))
    for end in (far, twin):
        end.command()
    limit = int(PARAMETERS["current_limit"])
    seen = []
    for ticks in range(1, LIFETIME + RAMP + 2):
        far.tick()
        seen.append(far.device.current)
        if ticks % SPEAK_EVERY == 0:
            twin.command()
        twin.tick()
        if ticks < LIFETIME:
            assert far.device.current == twin.device.current, "nothing differs while the word holds"
        elif ticks <= LIFETIME + RAMP:
            left = 1.0 - (ticks - LIFETIME - 1) / RAMP
            assert abs(far.device.current) <= limit * left + 1
    assert max(map(abs, seen[:LIFETIME])) > 20
    assert (far.device.fault, far.device.current, far.device.status.enabled) == (Fault.LINK_LOST, 0, 0)
    assert twin.device.fault is Fault.NONE
    assert any(state.limits & LimitFlag.RAMPING for state in far.states)
    far.check_at_rest(Fault.LINK_LOST)


def test_a_host_that_comes_back_in_the_ramp_finds_the_law_going_on(library: ctypes.CDLL) -> None:
    far = Far(library).into_the_wall()
    far.command()
    far.pass_ticks(LIFETIME + RAMP // 2)
    assert far.device.status.fault == 0
    far.states.clear()
    far.run(RATE // 10)
    assert far.device.fault is Fault.NONE
    assert far.states[0].limits & LimitFlag.RAMPING
    assert not any(state.limits & LimitFlag.RAMPING for state in far.states[2:])
    indices = [sample.index for sample in far.samples]
    assert indices == list(range(indices[0], indices[0] + len(indices))), "BATCH went on all the time"


def test_a_word_that_was_under_way_for_longer_than_it_holds_feeds_nothing(library: ctypes.CDLL) -> None:
    """As if the host were silent, however often such words come."""
    far, silent = (Far(library).into_the_wall() for _ in range(2))
    answered = far.host.answered
    for end in (far, silent):
        end.run(LIFETIME + SPEAK_EVERY)
    far.states.clear()
    while far.device.fault is Fault.NONE:
        old = m.Command(answered, 20_000, int(m.Mode.SUPERVISE), 0, 0)
        far.take(far.receive(far.host.send(old)))
        for end in (far, silent):
            end.pass_ticks(SPEAK_EVERY)
        assert far.device.current == silent.device.current
    assert far.device.fault is silent.device.fault is Fault.LINK_LOST
    assert all(state.limits & LimitFlag.COMMAND_TOO_OLD for state in far.states[:-1])
    far.check_at_rest(Fault.LINK_LOST)


def test_garbage_on_the_line_changes_nothing(library: ctypes.CDLL) -> None:
    far, twin = (Far(library).into_the_wall() for _ in range(2))
    noise = random.Random(3)
    for _ in range(40):
        far.receive(noise.randbytes(noise.randrange(1, 300)) + b"\0")
        for end in (far, twin):
            end.run(SPEAK_EVERY)
    np.testing.assert_array_equal(far.device.truth(), twin.device.truth())
    assert [s[:3] for s in far.samples] == [s[:3] for s in twin.samples]
    counters = far.device.status.counters
    assert counters.framing_errors + counters.crc_errors + counters.malformed > 30


def test_a_stale_session_is_not_a_host(library: ctypes.CDLL) -> None:
    far = Far(library).into_the_wall()
    far.command()
    for _ in range(0, LIFETIME + RAMP + SPEAK_EVERY, SPEAK_EVERY):
        far.say(far.session + 1)
        far.pass_ticks(SPEAK_EVERY)
    assert far.device.status.counters.stale_session >= 6
    assert (far.device.fault, far.device.current) == (Fault.LINK_LOST, 0)


@pytest.mark.parametrize(
    ("name", "value", "status"),
    [
        ("float_stiffness", float("inf"), Status.OUT_OF_RANGE),
        ("float_damping", -1.0, Status.OUT_OF_RANGE),
        ("position_rate", 1_000, Status.NOT_LIVE),
        ("current_limit", 32_767, Status.NOT_LIVE),
    ],
)
def test_a_parameter_that_cannot_be_is_refused_and_the_wall_goes_on(
    library: ctypes.CDLL, name: str, value: float, status: Status
) -> None:
    parameter = BY_NAME[name]
    kind = {"f32": "<Hf", "u32": "<HI", "u16": "<HI", "i32": "<Hi"}.get(parameter.ctype, "<HI")
    block = struct.pack(kind, parameter.id, value)
    far, twin = (Far(library).into_the_wall() for _ in range(2))
    for message in set_parameters(block, 900):
        ack = far.ask(message)
        if ack.status:
            break
    assert ack.status in (status, Status.OUT_OF_RANGE)
    assert ack.detail == parameter.id
    for end in (far, twin):
        end.run(RATE // 20)
    np.testing.assert_array_equal(far.device.truth(), twin.device.truth())
    assert far.device.fault is Fault.NONE


def test_hold_to_run_that_is_released_is_no_effort_until_it_is_held_again(library: ctypes.CDLL) -> None:
    far = Far(library, hold_to_run=1)
    far.run(SPEAK_EVERY)
    assert far.device.current == 0
    far.device.hold_to_run(True)
    far.into_the_wall()
    far.device.hold_to_run(False)
    far.tick()
    assert far.device.current == 0
    far.run(RATE // 50)
    assert (far.device.current, far.device.fault) == (0, Fault.NONE)
    assert far.states[-1].limits & LimitFlag.HOLD_TO_RUN_RELEASED
    rows = far.device.truth()
    assert abs(rows["effort_true"][-1]) < 1e-6
    far.device.hold_to_run(True)
    far.run(RATE // 5)
    assert far.device.fault is Fault.NONE


def test_a_brown_out_in_mid_run_is_no_effort_and_a_device_that_knows_nothing(library: ctypes.CDLL) -> None:
    far = Far(library).into_the_wall()
    before = far.device.elapsed_ns
    far.device.brown_out()
    assert (far.device.current, far.device.status.enabled, far.device.session) == (0, 0, 0)
    assert far.device.hardware.count == 0
    for _ in range(20):
        far.say(session=1)
        far.device.run(FOREVER_NS, SPEAK_EVERY)
        assert (far.device.current, far.device.status.enabled) == (0, 0)
    assert far.device.elapsed_ns > before
    assert far.device.status.counters.stale_session + far.device.status.counters.out_of_state > 0
    heir = Supervisor()
    heir.core, heir.receive, heir.tick = far.core, far.receive, far.tick  # type: ignore[method-assign]
    heir.identify()
    log = heir.take(heir.receive(heir.host.send(m.GetFaultLog(2, 0))))
    assert isinstance(log[0], m.FaultLog)
    assert log[0].fault == Fault.WATCHDOG_RESET
    assert far.device.state is State.FAULT


def test_two_devices_render_their_walls_side_by_side(library: ctypes.CDLL) -> None:
    together = [Far(library) for _ in range(2)]
    for _ in range(60):
        for far in together:
            far.run(SPEAK_EVERY)
    alone = Far(library)
    alone.run(60 * SPEAK_EVERY)
    for far in together:
        np.testing.assert_array_equal(far.device.truth(), alone.device.truth())
        assert far.samples == alone.samples


def test_after_fifty_thousand_ticks_every_count_told_is_the_truth(library: ctypes.CDLL) -> None:
    far = Far(library)
    far.run(50_000)
    truth, samples = far.device.truth(), far.samples
    assert len(samples) >= 50_000 - RATE // 200
    assert far.device.status.dropped == 0
    encoder = MODEL.encoder
    counts = encoder.sign * np.floor(truth["position_true"] / encoder.resolution + encoder.offset)
    told = np.array([(sample.index, sample.count) for sample in samples])
    first = int(np.flatnonzero(truth["sample_index"] == told[0, 0])[0])
    np.testing.assert_array_equal(told[:, 0], truth["sample_index"][first : first + len(told)])
    np.testing.assert_array_equal(told[:, 1], counts[first : first + len(told)])
    assert np.ptp(counts) > 100
