"""A bridge in virtual time: a simulated moteus behind a line that takes its time, a host at the other end.

`Bridged` is a `rig.devices.device.Link`, so that a host of the tests and `FramedDevice` talk to it. What goes wrong is
said by the number of a line, to the drive or from it.
"""

from __future__ import annotations

import ctypes
import errno
import heapq
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Literal

from rig.bench.bridge.bus import CanFrame
from rig.bench.bridge.library import Bridge, Drive
from rig.bench.bridge.moteus import Conversation, find, fit, switches_of
from rig.core.model import Encoder, RigModel
from rig.devices.device import DeviceUrl
from rig.devices.port import LoopPort
from rig.realtime.clock import VirtualClock
from rig.realtime.plugs import TRANSFER_SIGNATURE, WAIT_SIGNATURE, NativeFunction
from sim_backend.drives.bus import Frame
from sim_backend.drives.fdcanusb import Uart
from sim_backend.drives.moteus import MoteusOptions, SimulatedMoteus
from tests.conformance.host import RUN_PARAMETERS, Host
from tests.conformance.rigs import rotary_rig

_TRANSFER = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)
_WAIT = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)
UNIT_TWICE_NS = 125  # two units of device time
CAN_BYTES = 72  # of a struct canfd_frame
TRAVEL_NS = 80_000  # of a line, each way
PERIOD_NS = 1_000_000
CURRENT = 200  # quanta of 1 mA: 0.02 N·m at the handle, 0.01 at the output
SAFE = {"servo.timeout_mode": "0"}
SLOW = {
    **RUN_PARAMETERS,
    "position_rate": 100,
}  # Hz: a simulated drive is a program, and this computer may be busy
Way = Literal["to drive", "from drive"]
Strike = Callable[[bytes], bytes]


def bridged_rig(**changed: Any) -> RigModel:
    """`rotary_rig` on the encoder of a moteus, geared 1:2, with the lag of its current loop and its coarse sensor."""
    model = rotary_rig(lag_s=1e-3, current_noise_a=0.005, **changed)
    encoder = Encoder(counts_per_revolution=4096, ratio=2.0, sign=model.encoder.sign, offset=0.0)
    return replace(model, encoder=encoder)


class MemoryBus:
    """`rig.bench.bridge.bus.Bus` with a simulated drive on it, which answers at once."""

    place, descriptor, checksum, is_socket, messages = "memory", -1, True, False, ()

    def __init__(self, drive: SimulatedMoteus) -> None:
        self.drive = drive
        self.heard: list[CanFrame] = []  # that wait, of others too
        self.said = 0

    def send(self, frame: CanFrame) -> None:
        self.said += 1
        self.drive.run(self.drive.ticks + 30)
        self.heard += [
            CanFrame(one.identifier, one.data) for one in self.drive.receive(Frame(frame.id, frame.data))
        ]

    def receive(self, timeout_s: float) -> CanFrame | None:
        return self.heard.pop(0) if self.heard else None

    def close(self) -> None:
        pass


def found(drive: SimulatedMoteus, model: RigModel, number: int = 1) -> Drive:
    """What a bridge finds of a drive before it runs."""
    return fit(find(Conversation(MemoryBus(drive), number), number), model)


class RawCan:
    """A raw CAN socket of Linux, in the place of an adapter: one `struct canfd_frame` a message."""

    def open(self, unit: bytes) -> tuple[Frame | None, list[bytes]]:
        identifier, count = struct.unpack_from("<IB", unit)
        return Frame(identifier & 0x1FFFFFFF, unit[8 : 8 + count]), []

    def close(self, frame: Frame) -> list[bytes]:
        identifier = frame.identifier | (0x80000000 if frame.identifier > 0x7FF else 0)
        return [struct.pack("<IB3x64s", identifier, len(frame.data), frame.data)]


class Bridged:
    """A bridge, its drive and a line between them.

    Parameters
    ----------
    model
        The rig.
    settings
        Of the drive, where it is not as a bridge wants it.
    strikes
        Way and number of a line → what becomes of it: another line, or b"".
    """

    bytes_per_second: float | None = None
    messages: tuple[str, ...] = ()

    def __init__(
        self,
        model: RigModel | None = None,
        settings: Mapping[str, str] | None = None,
        *,
        strikes: Mapping[tuple[Way, int], Strike] | None = None,
        travel_ns: int = TRAVEL_NS,
        switches: Mapping[str, str] | None = None,
        socket: bool = False,
    ) -> None:
        self.url = DeviceUrl("moteus", "memory", {}, "moteus://memory")
        self.clock = VirtualClock()
        self.model = model or bridged_rig()
        self.drive = SimulatedMoteus(self.model, MoteusOptions(settings={**SAFE, **(settings or {})}))
        drive = replace(found(self.drive, self.model), switches=switches_of(switches or {}))
        self.bridge = Bridge(self.model, drive, socket=socket)
        self.adapter = RawCan() if socket else Uart()
        self.strikes = dict(strikes or {})
        self.lines = {"to drive": 0, "from drive": 0}
        self.travel_ns = travel_ns
        self.period_ns = PERIOD_NS
        self.alive = True
        self._began = self.drive.ticks
        self._due_ns = self.period_ns
        self._events: list[tuple[int, int, Way, bytes]] = []
        self._number = 0
        self._at_ns = 0  # to which the world has come
        self._said = b""  # and not yet read by a loop
        self._failure: BaseException | None = None
        self.bridge.start(0)

    # ------------------------------------------------------------------ a link

    def read(self, timeout_s: float) -> bytes:
        """Let time pass until the bridge has said something."""
        end_ns = self.clock.now_ns() + round(timeout_s * 1e9)
        said, self._said = self._said, b""
        while not (said := said + self.bridge.to_host()) and self.clock.now_ns() < end_ns:
            self.step(end_ns)
        return said

    def write(self, data: bytes) -> None:
        """Hand it in, now: the host may have let time pass by its clock alone."""
        while self._at_ns < self.clock.now_ns():
            self.step(self.clock.now_ns())
        if self.alive:
            self._to_drive(self.bridge.hear_host(data, self._now))

    def port(self) -> LoopPort:
        """Plug functions that come back into this object."""

        def native(kind: Any, function: Callable[..., int], signature: Any) -> NativeFunction:
            callback = kind(self._guarded(function))
            address = ctypes.cast(callback, ctypes.c_void_p).value
            assert address is not None
            return NativeFunction(address, signature, keep=callback)

        return LoopPort.on(
            self.clock,
            read=native(_TRANSFER, self._plug_read, TRANSFER_SIGNATURE),
            write=native(_TRANSFER, self._plug_write, TRANSFER_SIGNATURE),
            wait=native(_WAIT, self._plug_wait, WAIT_SIGNATURE),
            handle=0,
        )

    def _guarded(self, function: Callable[..., int]) -> Callable[..., int]:
        def call(*arguments: int) -> int:
            try:
                return function(*arguments)
            except BaseException as failure:
                self._failure = self._failure or failure
                return -errno.EIO

        return call

    def _plug_wait(self, handle: int, deadline_ns: int) -> int:
        self._said += self.bridge.to_host()
        while not self._said and self.clock.now_ns() < deadline_ns:
            self.step(deadline_ns)
            self._said = self.bridge.to_host()
        return int(bool(self._said))

    def _plug_read(self, handle: int, address: int, size: int) -> int:
        data, self._said = self._said[:size], self._said[size:]
        ctypes.memmove(address, data, len(data))
        return len(data)

    def _plug_write(self, handle: int, address: int, size: int) -> int:
        self.write(ctypes.string_at(address, size))
        return size

    def failure(self) -> BaseException | None:
        return self._failure

    def truth(self) -> None:
        return None

    def close(self) -> None:
        pass

    # ------------------------------------------------------------------ time

    @property
    def _now(self) -> int:
        return self._at_ns * 2 // UNIT_TWICE_NS

    def run(self, seconds: float) -> None:
        """Let time pass; what the bridge says waits."""
        end_ns = self.clock.now_ns() + round(seconds * 1e9)
        while self.clock.now_ns() < end_ns:
            self.step(end_ns)

    def step(self, end_ns: int) -> None:
        """Go to what happens next, and let it."""
        next_ns = min(end_ns, self._due_ns, self._events[0][0] if self._events else end_ns)
        self._at_ns = max(self._at_ns, next_ns)
        self.clock.sleep_until(next_ns)
        self.drive.run(self._began + next_ns * self.drive.rate_hz // 1_000_000_000)
        while self._events and self._events[0][0] <= next_ns:
            _, _, way, line = heapq.heappop(self._events)
            if way == "to drive":
                self._arrives(line)
            elif self.alive:
                self._to_drive(self.bridge.hear_bus(line, self._now))
        if self.alive:
            self._to_drive(self.bridge.hear_host(b"", self._now))
        if self._due_ns <= next_ns:
            if self.alive:
                self._to_drive(self.bridge.tick(self._now))
            self._due_ns += self.period_ns

    def _to_drive(self, said: bytes) -> None:
        frames = isinstance(self.adapter, RawCan)
        for at in range(0, len(said), CAN_BYTES) if frames else ():
            self._send("to drive", said[at : at + CAN_BYTES])
        for line in said.splitlines(keepends=True) if not frames else ():
            self._send("to drive", line)

    def _send(self, way: Way, line: bytes) -> None:
        strike = self.strikes.get((way, self.lines[way]))
        self.lines[way] += 1
        line = line if strike is None else strike(line)
        if line:
            self._number += 1
            heapq.heappush(self._events, (self._at_ns + self.travel_ns, self._number, way, line))

    def _arrives(self, line: bytes) -> None:
        frame, said = self.adapter.open(line)
        for answer in self.drive.receive(frame) if frame is not None else ():
            said += self.adapter.close(answer)
        for one in said:
            self._send("from drive", one)

    def happen(self, name: str, value: float = 0.0) -> None:
        """Let the world do something to the drive (`SimulatedMoteus.happen`)."""
        for frame in self.drive.happen(name, value):
            for line in self.adapter.close(frame):
                self._send("from drive", line)

    # ------------------------------------------------------------------ what is true

    def register(self, number: int) -> float:
        """A register of the drive (float), behind everybody's back."""
        (answer,) = self.drive.receive(Frame(0xFF00 | 1, bytes((0x1D, number))))
        (value,) = struct.unpack_from("<f", answer.data, 2)
        return float(value)

    @property
    def mode(self) -> int:
        """Of the drive."""
        return round(self.register(0x000))

    @property
    def torque(self) -> float:
        """That the drive wants to give now (N·m at its output)."""
        return self.register(0x03A) if self.mode in (10, 13) else 0.0


def plain_drive() -> Drive:
    """A drive that nobody was asked about."""
    return Drive(
        kind="moteus",
        firmware="moteus",
        id=1,
        counts_per_turn=16384.0,
        transmission=2.0,
        ranges={},
        settings={},
    )


def armed(world: Bridged | None = None, **values: int) -> tuple[Bridged, Host]:
    """A bridge with a host that has armed it."""
    world = world or Bridged()
    host = Host(world)
    host.begin(**values)
    return world, host


def push(host: Host, ticks: int, current: int = CURRENT) -> None:
    """Answer so many STATEs with a current."""
    for _ in range(ticks):
        host.next_state()
        host.command(current)
