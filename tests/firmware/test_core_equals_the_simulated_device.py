"""The Python device and the C core send the same bytes in each tick for the same input."""

import os
import random
import struct
from collections import deque
from collections.abc import Callable
from ctypes import CDLL
from dataclasses import replace
from itertools import pairwise
from typing import Any, Literal
from zlib import crc32

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input
from firmware_protocol.framing import encode_frame
from firmware_protocol.messages import DisarmFlag, Message, Mode
from firmware_protocol.packing import HEADER, LAYOUT_OF, LAYOUTS, data_limit
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import PARAMETERS, block_crc, encode_block
from firmware_protocol.transfer import set_parameters
from firmware_protocol.wire import wire_fields
from rig.core.model import Reference, RigModel
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.board.firmware_library import Counters
from sim_backend.board.hardware import Hardware
from sim_backend.board.lockstep import INDEX_EDGES
from tests.conformance.host import RUN_PARAMETERS
from tests.conformance.rigs import linear_rig, rotary_rig, unmeasured
from tests.conformance.tiers import first_by_default

WALKS = int(os.environ.get("HAPTIC_RIG_WALKS", "12"))
WALK_STEPS = 120
RATES = [50, 99, 300, 500, 700, 1_000, 1_100, 2_000, 3_000, 7_777, 20_000, 50_000]
LIFETIMES_US = [0, 1_000, 3_000, 20_000, 2**32 - 1]
AGES = [0, 0, 0, 1, 4, 61, 0xFFFF]  # STATEs since the one that a COMMAND answers
HOST_MESSAGES = [cls for type_id, cls in m.MESSAGES.items() if m.sender_of(type_id) is m.Role.HOST]
COUNTERS = [name for name, _ in Counters._fields_]


class Shaky(Hardware):
    """Simulated hardware whose next sample has an error of some counts and quanta."""

    jump = spike = 0

    def advance(self, current: int) -> None:
        super().advance(current)
        self.count += self.jump
        self.measured = max(-32_767, min(32_767, self.measured + self.spike))
        self.jump = self.spike = 0


class Puppet(Hardware):
    """Simulated hardware that moves by `speed` counts per tick and reports `measured` as its current."""

    speed = 0

    def advance(self, current: int) -> None:
        self.count += self.speed


class Pair:
    """Both devices with the same input; every step compares their state and their sent bytes."""

    def __init__(self, library: CDLL, model: RigModel, **options: Any) -> None:
        self.python = SimulatedDevice(model, **options)
        self.c = FirmwareDevice(model, library=library, law_maximum=0, **options)
        self.nonce = 0
        self.session = 0
        self.sequence = 0
        self.sent = b""
        self.frames: deque[bytes] = deque(maxlen=8)  # the last ones, to be sent again
        self.hardware: list[Any] = [device.hardware for device in (self.python, self.c)]
        for hardware in self.hardware:
            hardware.__class__ = Shaky

    def both(self, call: Callable[[Any], bytes | None]) -> None:
        self.sent = call(self.python) or b""
        assert self.sent == (call(self.c) or b"")
        status, connection = self.c.status, self.python.connection
        assert status.state == connection.state
        assert status.session == connection.session
        assert status.fault == self.python.fault

    def write(self, data: bytes) -> None:
        self.frames.append(data)
        self.both(lambda device: device.receive(data))

    def tick(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            self.both(lambda device: device.tick())

    def send(
        self, message: Message, session: int | None = None, sequence: int = 0, major: int = m.MAJOR
    ) -> bytes:
        frame = frame_of(
            message, self.python.connection.session if session is None else session, sequence, major
        )
        self.write(frame)
        return frame

    def next_nonce(self) -> int:
        self.nonce += 1
        return self.nonce & 0xFFFF

    def configure(self, values: dict[str, Value]) -> None:
        for message in set_parameters(encode_block(values), self.next_nonce()):
            self.send(message)

    def arm(self, session: int, flip: int = 0) -> None:
        configuration = self.python._configuration
        self.sequence = 0
        self.send(m.Arm(self.next_nonce(), configuration.hash, configuration.crc ^ flip), session)

    def begin(self, session: int = 1, **values: Value) -> None:
        self.send(m.Identify(self.next_nonce(), 0))
        self.configure({**RUN_PARAMETERS, **values})
        self.arm(session)

    def bring_to(self, state: State) -> None:
        if state >= State.ARMED:
            self.begin()
        elif state > State.BOOT:
            self.send(m.Identify(self.next_nonce(), 0))
        if state is State.CONFIGURED:
            self.configure(RUN_PARAMETERS)
        elif state is State.RUNNING:
            self.command(0)
        elif state is State.FAULT:
            self.both(lambda device: device.inject_fault(Fault.INTERNAL))
        assert self.c.state is state

    def answered(self, age: int = 0) -> int:
        """Return the sequence number of the STATE `age` before the newest."""
        return (self.python.connection.sequence_to_send(m.State) - 1 - age) & 0xFFFF

    def command(
        self,
        current: int,
        lifetime_us: int = 20_000,
        mode: int = 0,
        skip: int = 0,
        flags: int = 0,
        age: int = 0,
    ) -> None:
        self.sequence = (self.sequence + skip) & 0xFFFF
        command = m.Command(self.answered(age), lifetime_us, int(mode), flags, current)
        self.send(command, sequence=self.sequence)
        self.sequence = (self.sequence + 1) & 0xFFFF

    def ask_everything(self) -> None:
        """Send every request, for all pages and one behind the last."""
        for offset in range(0, 200, 40):
            self.send(m.GetParameters(self.next_nonce(), offset))
        for offset in (0, 34, len(self.python._configuration._packed) - 1, 0xFFFF):
            self.send(m.Identify(self.next_nonce(), offset))
        logged = len(self.python._faults._frozen)  # page by page, each names the total; then behind the last
        for first in (*range(0, logged + 2, 2), 254, 255, 256, 0xFFFF):
            self.send(m.GetFaultLog(self.next_nonce(), first))
        self.send(m.GetTime(self.next_nonce(), 2**64 - 1))
        self.send(m.GetReference(self.next_nonce()))
        self.send(m.GetStatistics(self.next_nonce()))
        counted, ours = self.python.connection.statistics, self.c.core.status.counters
        assert {name: getattr(ours, name) for name in COUNTERS} == {
            name: getattr(counted, name) for name in COUNTERS
        }


def frame_of(message: Message, session: int, sequence: int, major: int = m.MAJOR) -> bytes:
    layout = LAYOUT_OF[type(message)]
    return encode_frame(HEADER.pack(major, layout.type_id, 0, session, sequence) + layout.pack(message))


# ---------------------------------------------------------------------- what can happen


class Walked(Pair):
    """Both devices, and the events of a random walk that are more than one call of `Pair`."""

    def device(self, event: str, *arguments: Any) -> None:
        """Call a method of the devices, as the operator or the hardware does."""
        self.both(lambda device: getattr(device, event)(*arguments))

    def drive(self, ticks: int, *command: int) -> None:
        for _ in range(ticks):
            self.command(*command)
            self.tick()

    def run(self, session: int, values: dict[str, Value]) -> None:
        self.begin(session, **values)

    def disarm(self, flags: int) -> None:
        self.send(m.Disarm(self.next_nonce(), flags))

    def frame(self, header: tuple[int, ...], payload: bytes) -> None:
        self.write(encode_frame(bytes(header) + payload))

    def damaged(self, message: Message, bit: int, cut: int) -> None:
        frame = bytearray(frame_of(message, self.python.connection.session, 0))
        frame[bit // 8 % len(frame)] ^= 1 << bit % 8
        self.write(bytes(frame[: len(frame) - cut % len(frame)]))

    def push(self, effort: float) -> None:
        for hardware in self.hardware:
            hardware.external_effort = effort

    def shake(self, jump: int, spike: int) -> None:
        for hardware in self.hardware:
            hardware.jump, hardware.spike = jump, spike

    def again(self, back: int) -> None:
        if self.frames:
            self.write(self.frames[-1 - back % len(self.frames)])


CHOICES: dict[str, list[Value]] = {
    "current_limit": [0, 100, 3_000, 10_000],
    "continuous_current": [0, 50, 200, 10_000],
    "thermal_time_constant": [0.125, 0.5, 8.0],
    "slew_limit": [1, 30, 1_000, 65_534, 65_535],
    "speed_limit": [0, 1_000, 30_000, 2**32 - 1],
    "window_minimum": [-1_000_000, -100, -3, 0],
    "window_maximum": [0, 7, 100, 1_000_000],
    "command_lifetime_us": [100, 3_333, 20_000],
    "ramp_us": [0, 1, 777, 10_000],
    "hold_to_run": [0, 1],
    "verified": [0, 1, 1, 1],
}
SINGLES = [(name, choice) for name, choices in CHOICES.items() for choice in choices]
SHAKES = [(0, 0), (1, 0), (-40, 300), (5_000, -20_000), (-(2**30), 32_767)]


def random_message(rng: random.Random) -> Message:
    """Return any request or command, with plausible or extreme values."""
    cls = rng.choice(HOST_MESSAGES)
    values: dict[str, Any] = {}
    for name, wire in wire_fields(cls).items():
        if wire.ctype == "bytes":
            values[name] = rng.randbytes(rng.randrange(data_limit(cls) + 1))
        else:
            bits = int(wire.ctype[1:])
            values[name] = rng.choice([0, 1, 2, 9, (1 << bits - 1) - 1, rng.getrandbits(bits - 1)])
    return cls(**values)


def random_step(rng: random.Random) -> tuple[str, tuple[Any, ...]]:
    """Draw an event of the host, the operator or the hardware; most of them keep the session running."""
    choose, draw = rng.choice, rng.randrange
    values = {name: choose(choices) for name, choices in CHOICES.items() if rng.random() < 0.3}
    values["position_rate"] = choose(RATES)
    clear = int(DisarmFlag.CLEAR_FAULT)
    current = choose([1, -1]) * choose([0, 1, 60, 300, 501, 5_000, 32_767])
    mode, skip = choose([0, 0, 0, 0, 1, 2, 9]), choose([0, 0, 0, 1, 0x8000])
    kinds: list[tuple[int, str, tuple[Any, ...]]] = [
        (14, "drive", (draw(60), current, choose(LIFETIMES_US), mode, skip, choose([0, 2, 4, 6, 0xFF]), choose(AGES))),
        (8, "tick", (draw(40),)),
        (10, "run", (draw(4), values)),
        (6, "disarm", (choose([0, clear, clear, clear]),)),
        (4, "again", (draw(8),)),
        (3, "shake", choose(SHAKES)),
        (2, "push", (choose([0.0, 0.02, -0.5, 3.0]),)),
        (2, "device", ("press_emergency_stop", choose([True, False, False]))),
        (2, "device", ("hold_to_run", choose([True, True, False]))),
        (2, "device", ("sync_input", choose([True, False]))),
        (2, "send", (random_message(rng), draw(4), draw(3), m.MAJOR)),
        (2, "arm", (draw(4), choose([0, 0, 1]))),
        (2, "configure", (dict([choose(SINGLES)]),)),
        (1, "frame", ((choose([1, 1, 2]), rng.getrandbits(8), 0, draw(3), draw(4), 0), rng.randbytes(draw(60)))),
        (1, "damaged", (random_message(rng), draw(512), choose([0, 0, 1]))),
        (1, "write", (rng.randbytes(draw(300)),)),
        (1, "device", ("inject_fault", choose(list(Fault)[1:]))),
        (1, "ask_everything", ()),
        (1, "device", ("reset",)),
    ]  # fmt: skip
    ((_, name, arguments),) = rng.choices(kinds, [weight for weight, *_ in kinds])
    return name, arguments


def rig_of(sign: int = 1, drive: str = "current") -> RigModel:
    # Back-EMF acts under voltage drive alone.
    amplifier = {"lag_s": 2e-4, "current_noise_a": 0.004, "drive": drive, "back_emf_damping": 5e-3}
    return rotary_rig(damping=1e-4, coulomb=2e-3, sign=sign, **amplifier)


# ---------------------------------------------------------------------- the laws


@pytest.mark.parametrize("seed", first_by_default(range(WALKS)))
def test_a_long_walk_is_the_same_for_both(library: CDLL, seed: int) -> None:
    rng = random.Random(seed)
    pair = Walked(library, rig_of(rng.choice([1, -1]), ("current", "voltage")[seed % 2]), seed=seed)
    pair.begin(position_rate=rng.choice(RATES))
    for _ in range(WALK_STEPS):
        name, arguments = random_step(rng)
        getattr(pair, name)(*arguments)
    pair.write(b"\0")
    pair.ask_everything()


@given(st.lists(st.binary(max_size=600), max_size=8))
def test_the_same_is_counted_in_any_bytes(library: CDLL, pieces: list[bytes]) -> None:
    pair = Pair(library, rig_of())
    for piece in pieces:
        pair.write(piece)
    pair.write(b"\0")
    pair.ask_everything()


@example([(10, b"\1\0\0\0"), (10, b"\1\0\0\0")], False, 0)
@example([(11, b"\0\1\0\0"), (10, b"\1\0\0\0")], False, 0)
@example([(18, (30_000).to_bytes(4, "little")), (22, b"\xff" * 4)], True, 0)
@settings(max_examples=12)
@given(
    st.lists(st.tuples(st.integers(0, 25), st.binary(min_size=4, max_size=4)), max_size=6),
    st.booleans(),
    st.integers(0, 7),
)
def test_the_same_blocks_are_taken_and_refused(library: CDLL, entries: Any, in_order: bool, cut: int) -> None:
    pair = Pair(library, linear_rig())
    pair.send(m.Identify(pair.next_nonce(), 0))
    entries = sorted(dict(entries).items()) if in_order else entries
    block = b"".join(number.to_bytes(2, "little") + value for number, value in entries)[cut // 6 * cut :]
    for message in set_parameters(block, pair.next_nonce()):
        pair.send(message)
    pair.ask_everything()


@pytest.mark.parametrize("model", first_by_default([rotary_rig(), linear_rig()]), ids=["rotary", "linear"])
def test_every_range_ends_at_the_same_value(library: CDLL, model: RigModel) -> None:
    pair = Pair(library, model)
    pair.send(m.Identify(pair.next_nonce(), 0))
    for parameter in PARAMETERS:
        values = {0, 1, 2**31 - 1, 2**31, 2**32 - 1}
        for bound in (parameter.minimum, parameter.maximum, parameter.default, *parameter.excluded):
            number = _bits(parameter.ctype, bound)
            values |= {(number + step) & 0xFFFFFFFF for step in (-1, 0, 1)}
        for value in sorted(values):
            block = parameter.id.to_bytes(2, "little") + value.to_bytes(4, "little")
            for message in set_parameters(block, pair.next_nonce()):
                pair.send(message)


@pytest.mark.parametrize("state", [State.ARMED, State.RUNNING], ids=lambda state: state.name)
def test_an_armed_device_takes_and_refuses_the_same_blocks(library: CDLL, state: State) -> None:
    pair = Pair(library, rig_of())
    pair.bring_to(state)
    wall = {"float_stiffness": 3.0, "float_damping": 1.0, "fixed_surface": 1, "fixed_stiffness": 2}
    live = encode_block({**wall, "fixed_shift": 7})
    broken = [b"", live, live[:7], live[6:] + live[:6], live + live[-6:], b"\xff\xff" + live[2:6], live * 2,
              encode_block({"ramp_us": 3}) + live[:6], live + encode_block({"fixed_constant_low": 9}),
              live[:8] + b"\0\0\xc0\x7f", live * 5]  # fmt: skip
    for block in broken:
        for lie in (0, 1):
            nonce = pair.next_nonce()
            pair.send(m.SetBegin(nonce, len(block), block_crc(block) ^ lie))
            for offset in range(0, len(block), 46):
                pair.send(m.SetChunk(nonce, offset, block[offset : offset + 46]))
            for _ in range(2):
                pair.send(m.SetCommit(nonce))
            pair.tick()
    pair.send(m.SetBegin(pair.next_nonce(), 6, 0))
    pair.send(m.SetCommit(pair.nonce))  # bytes are missing
    pair.ask_everything()


def _bits(ctype: str, value: Value) -> int:
    code = "<f" if ctype == "f32" else "<q"
    return int.from_bytes(struct.pack(code, value)[:4], "little")


@settings(max_examples=20)
@given(
    st.integers(0, 1100),
    st.lists(st.tuples(st.integers(0, 1100), st.integers(0, 46)), max_size=40),
    st.booleans(),
)
def test_chunks_in_any_order_are_filled_alike(library: CDLL, length: int, chunks: Any, honest: bool) -> None:
    pair = Pair(library, rig_of())
    pair.send(m.Identify(pair.next_nonce(), 0))
    whole = encode_block(RUN_PARAMETERS)
    content = (whole * 30)[: max(length, 1100)]
    crc = block_crc(content[:length]) if honest else 0
    pair.send(m.SetBegin(9, length, crc))
    for offset, count in chunks:
        pair.send(m.SetChunk(9 + offset % 7 // 6, offset, content[offset : offset + count]))
        pair.send(m.SetCommit(9 + count % 2))
        if offset % 5 == 0:
            pair.send(m.SetBegin(9, length, crc if count % 5 else crc ^ 1))
    for offset in range(0, length, 46):
        pair.send(m.SetChunk(9, offset, content[offset : min(offset + 46, length)]))
    pair.send(m.SetCommit(9))
    pair.send(m.SetCommit(10))


@pytest.mark.parametrize("end", ["minimum", "maximum"])
def test_index_and_limit_switch_are_seen_alike(library: CDLL, end: Literal["minimum", "maximum"]) -> None:
    # The handle oscillates over both; a lost count shifts the index too.
    away = 1.0 if end == "minimum" else -1.0
    place = Reference(index=True, limit_switch=end, position=-0.01 * away, travel=1.0, index_distance=0.05)
    pair = Pair(library, replace(rotary_rig(damping=0.01), reference=place))
    pair.send(m.Identify(pair.next_nonce(), 0))
    edges, pressed = set(), set()
    for tick in range(160):
        for hardware in pair.hardware:
            hardware.external_effort = 0.1 * away * (1.0 if tick // 40 % 2 else -1.0)
            hardware.slip = tick // 100
        pair.tick()
        pair.send(m.GetReference(pair.next_nonce()))
        edges.add(int(pair.python.board.words[INDEX_EDGES]))
        pressed.add(pair.python.inputs & Input.LIMIT_SWITCH)
    assert pressed == {0, Input.LIMIT_SWITCH}
    assert edges == set(range(max(edges) + 1))
    assert max(edges) >= 3


def test_bytes_after_a_question_do_not_change_its_answer(library: CDLL) -> None:
    pair = Pair(library, rig_of())
    pair.begin()
    question = frame_of(m.GetStatistics(pair.next_nonce()), 1, 0)
    pair.write(question + b"noise\0" + question + frame_of(m.Command(0, 20_000, 0, 0, 9), 1, 0))
    pair.write(frame_of(m.Command(0, 20_000, 0, 0, 9), 1, 1) * 5_000)
    pair.ask_everything()


@pytest.mark.parametrize("fill", [0, 1])
def test_frames_of_every_length_are_counted_alike(library: CDLL, fill: int) -> None:
    # Also frames shorter than a header or longer than a batch, with a valid CRC.
    pair = Pair(library, linear_rig())
    for size in range(270):
        raw = (bytes([m.MAJOR]) + bytes([fill]) * size)[:size]
        runs = (raw + crc32(raw).to_bytes(4, "little")).split(b"\0")
        pair.write(b"".join(bytes([min(len(run) + 1, 255)]) + run for run in runs) + b"\0")
    pair.ask_everything()


@pytest.mark.parametrize("state", list(State), ids=lambda state: state.name)
def test_every_type_in_every_length_is_answered_alike(library: CDLL, state: State) -> None:
    model, pair = linear_rig(), None
    for type_id in (*range(0x1A), 0x3E, 0x40, 0x41, 0x42, 0x5E, 0x60, 0x61, 0xFE, 0xFF):
        layout = LAYOUTS.get(type_id)
        sizes = {0, 1, 2, 3, 8, 50, 51, 242} | (
            {layout.size - 1, layout.size, layout.size + 1} if layout else set()
        )
        for session in (0, 1):
            if pair is None or pair.c.state is not state:
                pair = Pair(library, model)
                pair.bring_to(state)
            for size in sorted(sizes):
                header = HEADER.pack(m.MAJOR, type_id, 0, session, size)
                pair.write(encode_frame(header + bytes(range(1, size + 1))))
            pair.tick()


@pytest.mark.parametrize("rate", first_by_default([7_777, 50, 99, 700, 1_000, 50_000]))
def test_a_long_run_ends_alike(library: CDLL, rate: int) -> None:
    pair = Pair(library, rig_of(), seed=rate)
    pair.begin(position_rate=rate, current_limit=10_000, continuous_current=300, thermal_time_constant=0.125)
    for tick in range(2_000):
        pair.command(700 if tick // 7 % 2 else -700, lifetime_us=20_000)
        pair.tick()
    pair.tick(round(0.04 * rate) + 5)
    pair.ask_everything()
    assert pair.python.fault in {Fault.LINK_LOST, Fault.THERMAL}


def test_the_fault_log_survives_its_clear_and_the_next_run(library: CDLL) -> None:
    pair = Walked(library, rig_of())
    for session, ticks in pairwise([1, 300, 20]):
        pair.begin(session % 255)
        pair.drive(ticks, 60)
        pair.device("inject_fault", Fault.BATCH_OVERFLOW)
        pair.tick(3)
        pair.ask_everything()
        pair.send(m.Disarm(pair.next_nonce(), DisarmFlag.CLEAR_FAULT))
        pair.tick(400)
        pair.ask_everything()


@pytest.mark.parametrize("start", [0, 5, 0xFFFF])
def test_the_circle_of_sequences_is_halved_at_the_same_place(library: CDLL, start: int) -> None:
    for step in (0, 1, 2, 0x7FFE, 0x7FFF, 0x8000, 0x8001, 0xFFFF):
        pair = Pair(library, rig_of())
        pair.begin()
        for sequence, current in ((start, 10), ((start + step) & 0xFFFF, 20)):
            pair.send(m.Command(pair.answered(), 20_000, 0, 0, current), sequence=sequence)
            pair.tick()
        pair.ask_everything()


@pytest.mark.parametrize("rate", [700, 1_000, 7_777, 20_000])
def test_a_command_that_was_longer_under_way_than_its_lifetime_is_not_activated(
    library: CDLL, rate: int
) -> None:
    # On the circle of sequences too: from half of it on an age lies behind.
    pair = Pair(library, rig_of())
    pair.begin(position_rate=rate)
    oldest = 3_000 * rate // 1_000_000
    for age in (oldest, oldest + 1, 0, 2 * oldest + 1, 0x7FFF, 0, 0x8000, 0xFFFE):
        pair.command(50)
        pair.tick()
        current = 50 if age > oldest else 60
        pair.command(60, lifetime_us=3_000, age=age)
        pair.tick()
        assert pair.c.core.status.current == current, age
    pair.ask_everything()
    assert pair.c.core.status.counters.reordered == 5
    pair.command(60, mode=Mode.STOP, age=0x8000)
    pair.tick()
    assert pair.c.core.status.current == 0, "STOP is never too old"


@pytest.mark.parametrize("seed", first_by_default(range(12), 2))
def test_the_motion_is_judged_alike_at_every_threshold(library: CDLL, seed: int) -> None:
    # Strokes with and against the effort, rest and reversals, about as long as the windows of the monitors.
    rng = random.Random(seed)
    sign = rng.choice([1, -1])
    pair = Pair(library, unmeasured(rotary_rig(coulomb=2e-3, sign=sign)))
    for hardware in pair.hardware:
        hardware.__class__ = Puppet
    for session in range(1, 30):
        rate = rng.choice([200, 1_000, 2_000])
        window = max(1, rate // 200)
        pair.send(m.Disarm(pair.next_nonce(), DisarmFlag.CLEAR_FAULT))
        limits = {"speed_limit": 1_000 * rng.randrange(4), "hold_to_run": rng.randrange(2)}
        position = pair.python.hardware.count
        limits["window_minimum"] = position - rng.randrange(90)
        limits["window_maximum"] = position + rng.randrange(90)
        pair.both(lambda device: device.hold_to_run(True))
        pair.begin(session, position_rate=rate, current_limit=500, **limits)
        while pair.c.state in {State.ARMED, State.RUNNING}:
            current, speed = rng.choice([0, 99, 100, 101, 300]) * rng.choice([1, -1]), rng.randrange(-3, 4)
            measured = rng.choice([0, 0, 0, current, 11_000, -11_000, 11_001]) if rng.random() < 0.1 else 0
            for hardware in pair.hardware:
                hardware.speed, hardware.measured = speed, measured
            for _ in range(rng.choice([1, window - 1, window, window + 1, 3 * window, 10 * window])):
                pair.command(current)
                pair.tick()


def test_a_motor_that_bears_nothing_gets_nothing_from_the_first_tick(library: CDLL) -> None:
    pair = Pair(library, rotary_rig())  # whose sensor is silent: the heat is exactly zero
    pair.begin(continuous_current=0)
    pair.command(100)
    pair.tick()
    assert pair.c.core.status.current == 0


@pytest.mark.parametrize("slew_limit", [65_534, 65_535])
def test_the_largest_slew_limits_let_every_change_pass(library: CDLL, slew_limit: int) -> None:
    pair = Pair(library, rotary_rig(effort_limit=10.0))
    pair.begin(slew_limit=slew_limit, current_limit=32_767, continuous_current=32_767)
    for current in (32_767, -32_767, -32_768, 32_767):
        pair.command(current)
        pair.tick()
        assert pair.c.core.status.current == max(current, -32_767)


def test_a_nonce_of_another_session_is_no_repeat(library: CDLL) -> None:
    pair = Pair(library, rig_of())
    pair.bring_to(State.CONFIGURED)
    configuration = pair.python._configuration
    pair.send(m.Arm(77, configuration.hash ^ 1, configuration.crc), session=3)
    pair.send(m.Arm(77, configuration.hash, configuration.crc), session=4)
    assert pair.c.state is State.ARMED


def test_a_late_repeat_of_disarm_leaves_a_new_fault_latched(library: CDLL) -> None:
    pair = Walked(library, rig_of())
    pair.begin()
    late = pair.send(m.Disarm(77, DisarmFlag.CLEAR_FAULT), session=1)
    pair.device("inject_fault", Fault.ENCODER)
    pair.write(late)
    assert (pair.c.state, pair.c.fault) == (State.FAULT, Fault.ENCODER)
    pair.send(m.Disarm(78, DisarmFlag.CLEAR_FAULT), session=1)
    assert (pair.c.state, pair.c.fault) == (State.CONFIGURED, Fault.NONE)


def test_every_fault_has_the_same_gravity(library: CDLL) -> None:
    pair = Walked(library, rig_of())
    faults = [fault for fault in Fault if fault is not Fault.NONE]
    for session, (first, second) in enumerate(pairwise([*faults, *reversed(faults)]), start=1):
        pair.begin(session)
        pair.device("inject_fault", first)
        pair.device("inject_fault", second)
        pair.ask_everything()
        pair.send(m.Disarm(pair.next_nonce(), DisarmFlag.CLEAR_FAULT))
