"""Simulated drives under test: single frames, and a line in memory whose time advances only when the drive waits."""

import struct
import threading
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from rig.core.model import Encoder, RigModel
from sim_backend.drives.bus import DriveModel, Frame, SimulatedAdapter
from sim_backend.drives.can_simple import CanSimpleCommand
from sim_backend.drives.faults import DriveScript
from sim_backend.drives.moteus import MoteusOptions, SimulatedMoteus
from sim_backend.drives.odrive import OdriveOptions, SimulatedOdrive
from sim_backend.drives.serving import Serving
from tests.conformance.rigs import rotary_rig

CAN_FRAME = struct.Struct("=IB3x8s")  # identifier, length, padding, data: include/uapi/linux/can.h
CANFD_FRAME = struct.Struct("=IBB2x64s")  # identifier, length, flags, padding, data
MS = 1_000_000
RATIO = 2.0  # turns of the drive's shaft for one of the link
INERTIA = 1e-3  # kg·m² at the link
KT = 0.1 / RATIO  # N·m/A at the shaft
NAN = float("nan")
Units = Iterable[tuple[int, bytes]]  # bytes with the times of their arrival (ns)


def drive_rig(**changed: Any) -> RigModel:
    model = rotary_rig(inertia=changed.pop("inertia", INERTIA), **changed)
    encoder = Encoder(counts_per_revolution=4096, ratio=RATIO, sign=model.encoder.sign, offset=0.0)
    return replace(model, encoder=encoder)


class Moteus:
    """A moteus and a host that sends it single frames; registers are read as floats unless another form is named."""

    def __init__(
        self, model: RigModel | None = None, settings: Mapping[str, str] | None = None, **options: Any
    ) -> None:
        self.drive = SimulatedMoteus(model or drive_rig(), MoteusOptions(settings=settings or {}, **options))

    def wait(self, seconds: float) -> None:
        self.drive.run(self.drive.ticks + round(seconds * self.drive.rate_hz))

    def send(self, data: bytes, identifier: int = 0x8001) -> bytes | None:
        answers = self.drive.receive(Frame(identifier, data))
        return answers[0].data if answers else None

    def read(self, register: int, form: str = "f") -> float:
        """Read a register as float, or as the integer type of the code ``b``, ``h`` or ``i``."""
        kind = "bhif".index(form)
        answer = self.send(bytes((0x11 | kind << 2, *_varuint(register))))
        assert answer is not None
        assert answer[0] == 0x21 | kind << 2, answer.hex()
        (value,) = struct.unpack_from("<" + form, answer, 1 + len(_varuint(register)))
        return value

    def write(self, mode: int, registers: Mapping[int, float] | None = None) -> bytes | None:
        """Command a mode with registers as floats."""
        data = bytes((0x01, 0x00, mode))
        for register, value in (registers or {}).items():
            data += bytes((0x0D, *_varuint(register))) + struct.pack("<f", value)
        return self.send(data)

    def torque(self, torque: float, **others: float) -> None:
        """Command only a feed-forward torque (N·m), with a `timeout` (s) if given."""
        registers = {0x020: NAN, 0x022: torque, 0x023: 0.0, 0x024: 0.0, 0x02B: 0.0}
        if "timeout" in others:
            registers[0x027] = others["timeout"]
        self.write(10, registers)

    def start(self, **others: float) -> None:
        """Enable the drive without torque, and wait until it is in position mode."""
        self.torque(0.0, timeout=NAN)
        self.wait(0.02)
        assert self.read(0) == 10
        self.torque(0.0, **others)

    def console(self, line: str) -> str:
        self.send(bytes((0x40, 1, len(line) + 1)) + line.encode() + b"\n", 0x0001)
        text = b""
        while (answer := self.send(bytes((0x42, 1, 60)))) is not None and answer[2]:
            text += answer[3:]
        return text.decode()

    @property
    def command(self) -> float:
        """The torque at the shaft, behind the amplifier (N·m)."""
        return self.drive.motor.torque


class Odrive:
    """An ODrive at node 0 and a host that sends it single messages."""

    def __init__(
        self, model: RigModel | None = None, settings: Mapping[str, str] | None = None, **options: Any
    ) -> None:
        self.drive = SimulatedOdrive(model or drive_rig(), OdriveOptions(settings=settings or {}, **options))

    def wait(self, seconds: float) -> list[Frame]:
        return self.drive.run(self.drive.ticks + round(seconds * self.drive.rate_hz))

    def send(self, command: CanSimpleCommand, form: str = "", *values: float) -> list[Frame]:
        return self.drive.receive(Frame(command, struct.pack("<" + form, *values)))

    def ask(self, command: CanSimpleCommand, form: str) -> tuple[Any, ...]:
        (answer,) = self.drive.receive(Frame(command, b"", remote=True))
        return struct.unpack("<" + form, answer.data)

    def start(self) -> None:
        """Select torque control and closed loop."""
        self.send(CanSimpleCommand.SET_CONTROLLER_MODE, "II", 1, 1)
        self.send(CanSimpleCommand.SET_AXIS_STATE, "I", 8)
        self.wait(0.001)

    @property
    def state(self) -> int:
        return int(self.ask(CanSimpleCommand.HEARTBEAT, "IBBBx")[1])

    @property
    def errors(self) -> tuple[int, int]:
        """The active errors, and the reason of the last disarming."""
        active, reason = self.ask(CanSimpleCommand.GET_ERROR, "II")
        return active, reason


class Wire:
    """A line in memory: byte units with arrival times, and a clock that advances while the drive waits."""

    def __init__(self, units: Units) -> None:
        self.now = 0
        self.sent: list[tuple[int, bytes]] = []  # by the drive, with the time (ns)
        self.pulled = False
        self._units = deque(units)

    def clock(self) -> int:
        return self.now

    def read(self, deadline_ns: int) -> bytes:
        at, unit = self._units[0] if self._units else (deadline_ns + 1, b"")
        if at > deadline_ns:
            self.now = max(self.now, deadline_ns)
            return b""
        self._units.popleft()
        self.now = max(self.now, at)
        return unit

    def write(self, frames: bytes) -> None:
        self.sent.append((self.now, frames))

    def unplug(self) -> None:
        self.pulled = True


def served(
    drive: DriveModel, adapter: SimulatedAdapter, units: Units, script: DriveScript, duration_s: float
) -> Wire:
    wire = Wire(units)
    Serving(drive, adapter, wire, script, threading.Event(), clock=wire.clock).run(duration_s)
    return wire


def _varuint(value: int) -> tuple[int, ...]:
    return (value,) if value < 0x80 else (value & 0x7F | 0x80, value >> 7)
