"""A device that sends false values: currents, clock, index, count, limits, faults, identity, or any field of a reply.

It obeys commands like a correct device, with valid CRCs; or the link delivers old frames as new ones. Every run must
end without effort and, unless it went well, with a reason; contradicting values must never be judged a stable wall.
`KNOWN` lists the false values that a host cannot detect, each with its reason; they are counted separately.
"""

import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from firmware_protocol import dictionary as dictionaries
from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input, LimitFlag
from firmware_protocol.framing import FrameSplitter, encode_frame
from firmware_protocol.messages import Message
from firmware_protocol.packing import HEADER, LAYOUTS
from firmware_protocol.wire import wire_fields
from rig import config
from rig.config import presets
from rig.control.verdict import Kind as Verdict
from rig.core.errors import RigError
from rig.devices import framed
from rig.devices.fault_script import Direction, FaultKind, Faults, FrameFault
from rig.devices.framed import FramedDevice
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.safety import IDLE_LIFETIME_S
from sim_backend.ends.link import MemoryLink
from tests.attack.area import Outcome, require

EXPERIMENT = config.override(
    config.with_realtime(presets.load("koul-compliant")),
    {"trial.duration_s": 0.35, "trial.release_s": 0.02, "homing.settle_s": 0.02, "verdict.tail_s": 0.1},
)
MODEL = config.rig_model(EXPERIMENT)
LIFETIME, LONGEST = 5, 40  # of a command, and by how much a link holds it back (ticks)
START = -0.015
REST_S = 0.05  # lifetime and ramp, and some
TICKS = 450  # about what a run takes
ANSWERS_MOST = 20_000  # in one run; a host that sends requests without end is a finding
U16, U32, I16 = 0xFFFF, 0xFFFFFFFF, 0x7FFF

Lie = Callable[[m.State, int, random.Random], m.State]  # STATE, number of lies so far, chance


def _wrap(value: int, bits: int) -> int:
    return (value + (1 << bits - 1)) % (1 << bits) - (1 << bits - 1)


def _freeze(name: str) -> Lie:
    kept: dict[int, int] = {}

    def lie(state: m.State, lies: int, chance: random.Random) -> m.State:
        if lies == 0:
            kept[0] = getattr(state, name)
        return replace(state, **{name: kept[0]})

    return lie


def _lie_by(name: str, change: Callable[[int, int], int]) -> Callable[[], Lie]:
    """Return a lie that computes the sent value from the true value and the number of lies so far."""
    return lambda: lambda state, lies, chance: replace(state, **{name: change(getattr(state, name), lies)})


# Name → what makes a lie. Each contradicts something else that the host receives, or that it has sent.
CONTRADICTIONS: dict[str, Callable[[], Lie]] = {
    "measured current: none": _lie_by("current_measured", lambda true, lies: 0),
    "measured current: opposite": _lie_by("current_measured", lambda true, lies: max(-I16, -true)),
    "measured current: threefold": _lie_by(
        "current_measured", lambda true, lies: max(-I16, min(I16, 3 * true))
    ),
    "measured current: frozen": lambda: _freeze("current_measured"),
    "active current: none": _lie_by("current_commanded", lambda true, lies: 0),
    "active current: opposite": _lie_by("current_commanded", lambda true, lies: max(-I16, -true)),
    "active current: half": _lie_by("current_commanded", lambda true, lies: true // 2),
    "device time: a second ahead": _lie_by("device_time", lambda true, lies: (true + 16_000_000) & U32),
    "device time: a second back": _lie_by("device_time", lambda true, lies: (true - 16_000_000) & U32),
    "device time: frozen": lambda: _freeze("device_time"),
    "device time: twice as fast": _lie_by("device_time", lambda true, lies: (true + lies * 16_000) & U32),
    "sample index: a thousand ahead": _lie_by("sample_index", lambda true, lies: (true + 1_000) & U32),
    "sample index: two billion ahead": _lie_by(
        "sample_index", lambda true, lies: (true + 2_000_000_000) & U32
    ),
    "sample index: a thousand back": _lie_by("sample_index", lambda true, lies: (true - 1_000) & U32),
    "sample index: frozen": lambda: _freeze("sample_index"),
    "sample index: every second": _lie_by("sample_index", lambda true, lies: (2 * true) & U32),
    "count: jumps far": _lie_by("count", lambda true, lies: _wrap(true + 1_000_000, 32)),
    "count: jumps to the end": _lie_by("count", lambda true, lies: -(1 << 31)),
    "count: shakes": _lie_by("count", lambda true, lies: _wrap(true + (40 if lies % 2 else -40), 32)),
    "count: frozen": lambda: _freeze("count"),
    "edge time: ahead of the sample": _lie_by("edge_time", lambda true, lies: (true + 160_000_000) & U32),
    "limits: all": _lie_by("limits", lambda true, lies: U16),
    "limits: ramping": _lie_by("limits", lambda true, lies: int(LimitFlag.RAMPING)),
    "fault: an unknown one": _lie_by("fault", lambda true, lies: 37),
    "fault: over-speed, but it runs": _lie_by("fault", lambda true, lies: 2),
    "state: fault without a fault": _lie_by("state", lambda true, lies: int(State.FAULT)),
    "state: not armed": _lie_by("state", lambda true, lies: int(State.CONFIGURED)),
    "state: boot": _lie_by("state", lambda true, lies: int(State.BOOT)),
    "state: one that does not exist": _lie_by("state", lambda true, lies: 200),
    "inputs: emergency stop, but it runs": _lie_by(
        "inputs", lambda true, lies: true | int(Input.EMERGENCY_STOP)
    ),
    "command: none yet": _lie_by("command_age", lambda true, lies: U16),
    "command: another sequence": _lie_by("command_sequence", lambda true, lies: (true + 30_000) & U16),
    "missed ticks: many": _lie_by("missed_ticks", lambda true, lies: U16),
}
KNOWN = {"count: frozen": "a hand that holds still looks like that on two single-ended channels"}


# Changes of a dictionary: false values, and another identity.
IDENTITIES: tuple[dict[str, Any], ...] = (
    {"current_quantum_a": MODEL.amplifier.current_quantum_a * 10.0},
    {"current_quantum_a": 1e-300},
    {"current_quantum_a": 1e300},
    {"time_unit_ns": 125.0},
    {"time_unit_ns": 1e-9},
    {"time_unit_ns": 1e300},
    {"device": "another"},
    {"device": ""},
    {"device": "\x1b[2J{url} %s\n" * 50},
    {"simulated": False},
    {"position_rate_default": 1},
    {"position_rate_maximum": 1},
    {"position_rate_maximum": 10**6, "position_rate_default": 10**6},
    {"parameters": ()},
    {"faults": (), "statuses": ()},
)


class EndlessError(Exception):
    """Raised when a host sends requests without end."""


@dataclass
class Script:
    """The values that a `Liar` falsifies: its STATEs from one sample on, or one field of some replies."""

    after: int  # STATEs of the session, before it begins
    lie: Lie | None = None
    lasts: int = 1 << 30  # STATEs
    answer: type[Message] | None = None
    field: str = ""
    share: float = 1.0  # of the answers of this type
    dictionary: dict[str, Any] | None = None  # its false entries, under a valid hash
    session: int = 0  # added to that of each frame
    sequence: int = 0
    late: tuple[FrameFault, ...] = ()  # what the link holds back
    checks_age: bool = True  # the device rejects old commands


class Liar(SimulatedDevice):
    """A simulated device that behaves correctly but sends false values."""

    def __init__(self, script: Script, chance: random.Random) -> None:
        super().__init__(MODEL, initial_position=START)
        self._script, self._chance = script, chance
        self._seen = self._lies = self._answers = 0
        if script.dictionary is not None:
            packed = dictionaries.encode(replace(self._dictionary, **script.dictionary))
            self._configuration._packed = packed
            self._configuration.hash = dictionaries.dictionary_hash(packed)
            self._lies = 1

    @property
    def lie_count(self) -> int:
        return self._lies

    def tick(self) -> bytes:
        sent = super().tick()
        if not sent or not self.connection.session:
            return sent
        self._seen += 1
        script = self._script
        if self._seen <= script.after or self._lies >= script.lasts:
            return sent
        return self._frames(sent, self._apply_lie)

    def receive(self, data: bytes, *, received_at: int | None = None) -> bytes:
        sent = super().receive(data, received_at=received_at)
        self._answers += bool(sent)
        if self._answers > ANSWERS_MOST:
            raise EndlessError
        return self._frames(sent, self._handle_answer) if sent and self._script.answer else sent

    def _execute_command(self, command: m.Command, sequence: int) -> None:
        if not self._script.checks_age:
            newest = (self.connection.sequence_to_send(m.State) - 1) & U16
            command = replace(command, state_sequence=newest)
        super()._execute_command(command, sequence)

    def _frames(self, sent: bytes, change: Callable[[Message], Message]) -> bytes:
        return b"".join(self._frame(raw, change) for raw in FrameSplitter().feed(sent))

    def _frame(self, raw: bytes, change: Callable[[Message], Message]) -> bytes:
        major, type_id, flags, session, sequence = HEADER.unpack_from(raw)
        layout, script = LAYOUTS[type_id], self._script
        message = change(layout.unpack(raw))
        session, sequence = (session + script.session) & 0xFF, (sequence + script.sequence) & U16
        return encode_frame(HEADER.pack(major, type_id, flags, session, sequence) + layout.pack(message))

    def _apply_lie(self, message: Message) -> Message:
        if not isinstance(message, m.State) or self._script.lie is None:
            return message
        changed = self._script.lie(message, self._lies, self._chance)
        self._lies += 1
        return changed

    def _handle_answer(self, message: Message) -> Message:
        script = self._script
        if type(message) is not script.answer or self._chance.random() > script.share:
            return message
        self._lies += 1
        return replace(message, **{script.field: _false_value(message, script.field, self._chance)})  # type: ignore[type-var]


def _any_value(chance: random.Random, ctype: str) -> int:
    """Return a value of a C integer type, often a small number or an end of the range."""
    bits = int(ctype[1:])
    lowest = -(1 << bits - 1) if ctype[0] == "i" else 0
    highest = lowest + (1 << bits) - 1
    ends = (lowest, highest, highest // 2 + 1)
    return chance.choice((chance.randrange(4), chance.choice(ends), chance.randint(lowest, highest)))


def _false_value(message: Message, name: str, chance: random.Random) -> Any:
    ctype = wire_fields(type(message))[name].ctype
    if ctype != "bytes":
        return _any_value(chance, ctype)
    data = bytearray(getattr(message, name))
    if data and chance.random() < 0.7:
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        return bytes(data)
    return bytes(data[: chance.randrange(len(data) + 1)])


ANSWERS = [
    (cls, field.name)
    for cls in (m.Identity, m.Ack, m.Parameters, m.Time, m.FaultLog, m.Statistics, m.Reference)
    for field in fields(cls)  # type: ignore[arg-type]
]


class Liars:
    """The area "liars": each case is one hit on one `Liar`; contradictions and drawn lies alternate."""

    def __init__(self, place: Path) -> None:
        self._place = place
        self._numbers = 0
        kind, reasons, _ = self._run_hit(Script(after=1 << 30), random.Random(0))
        require(kind == Verdict.STABLE, "an honest device: ", kind, reasons)

    def attack(self, case: int, chance: random.Random) -> Outcome:
        """Run a hit on one `Liar` and check its verdict."""
        name, script = self._draw_case(case, chance)
        kind, reasons, lie_count = self._run_hit(script, chance)
        figures = Counter({"runs": 1, "lies": lie_count, f"ended: {kind}": 1})
        require(kind == Verdict.STABLE or reasons, name, "ended without a reason:", kind)
        if name in CONTRADICTIONS and kind == Verdict.STABLE and lie_count > 0:
            if name in KNOWN:
                return Outcome(figures, Counter({f"{name}: {KNOWN[name]}": 1}))
            require(False, name, f"after {script.after} STATEs: a stable wall")
        require(kind != Verdict.STABLE or not script.late, name, "a stable wall")
        return Outcome(figures)

    def _draw_case(self, case: int, chance: random.Random) -> tuple[str, Script]:
        after = chance.randrange(TICKS)
        if case % 2 == 0:
            name = list(CONTRADICTIONS)[case // 2 % len(CONTRADICTIONS)]
            return name, Script(after=chance.randrange(50, TICKS // 2), lie=CONTRADICTIONS[name]())
        if chance.random() < 0.3:
            state_fields = [field.name for field in fields(m.State)]
            chosen = chance.sample(state_fields, chance.randrange(1, 4))

            def anything(state: m.State, lies: int, chance: random.Random) -> m.State:
                return replace(state, **{name: _false_value(state, name, chance) for name in chosen})

            return f"STATE {chosen}", Script(
                after=after, lie=anything, lasts=chance.choice((1, 2, 10, 1 << 30))
            )
        if chance.random() < 0.2:
            dictionary = chance.choice(IDENTITIES)
            return f"dictionary {dictionary}", Script(after=1 << 30, dictionary=dictionary)
        if chance.random() < 0.1:
            session, sequence = chance.choice(((1, 0), (0, 1), (0, 32_768), (0, 65_535)))
            honest: Lie = lambda state, lies, chance: state  # noqa: E731
            return "header", Script(after=after, lie=honest, session=session, sequence=sequence)
        if chance.random() < 0.2:
            return self._draw_delayed_link(chance)
        cls, field = chance.choice(ANSWERS)
        return f"{cls.__name__}.{field}", Script(
            after, answer=cls, field=field, share=chance.choice((1.0, 0.3, 0.05))
        )

    def _draw_delayed_link(self, chance: random.Random) -> tuple[str, Script]:
        """Draw a link that delivers one frame per tick and, from mid-run on, each of them late by the same time."""
        ticks, checks_age = chance.randrange(LIFETIME + 1, LONGEST + 1), chance.random() < 0.5
        direction, first = chance.choice(tuple(Direction)), chance.randrange(TICKS // 3, TICKS // 2)
        late = tuple(
            FrameFault(kind=FaultKind.DELAY, direction=direction, frame=frame, ticks=ticks)
            for frame in range(first, 2 * TICKS)
        )
        check = "checks" if checks_age else "ignores"
        name = f"link: {direction.value} {ticks} ticks late, the device {check} the age"
        return name, Script(after=1 << 30, late=late, checks_age=checks_age)

    def _run_hit(self, script: Script, chance: random.Random) -> tuple[str, tuple[str, ...], int]:
        """Run a hit on a `Liar` and require zero effort; return verdict or error, reasons, number of lies."""
        self._numbers += 1
        framed._dictionaries.clear()
        liar = Liar(script, chance)
        link = MemoryLink(liar, Faults(script.late))
        output = self._place / str(self._numbers)
        if chance.random() < 0.3:
            liar.inject_fault(chance.choice((Fault.OVER_SPEED, Fault.ENCODER)))
        try:
            with FramedDevice(link) as device:
                (result,) = hit(HitRequest(experiment=EXPERIMENT, device=device, output=output), admit)
            kind, reasons = str(result.verdict.kind), result.verdict.reasons
        except RigError as error:
            kind, reasons = type(error).__name__, (str(error),)
            require(error.message and error.remedy, "an error without remedy:", repr(error))
        link.elapse(REST_S)
        require(liar.current == 0, "still", liar.current, "quanta after", kind, reasons)
        link.elapse(IDLE_LIFETIME_S)
        require(liar.connection.state not in (State.ARMED, State.RUNNING), "still armed after", kind, reasons)
        return kind, reasons, liar.lie_count
