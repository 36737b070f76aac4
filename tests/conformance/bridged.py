"""A bridge in virtual time: a simulated drive behind a line with a transfer time, and a host at the other end.

`Bridged` is a `rig.devices.device.Link`, so that a host of the tests and `FramedDevice` can use it. A fault is given
with the number of the line that it changes, to the drive or from it.
"""

import heapq
import json
import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from firmware_protocol import messages as m
from rig.core.model import Encoder, RigModel
from rig.devices.device import DeviceUrl
from rig.devices.port import LoopPort
from rig.extras.drives import moteus, odrive
from rig.extras.drives.bus import CanFrame
from rig.extras.drives.faults import TEXTS
from rig.extras.drives.library import Bridge, FittedDrive
from rig.realtime.callbacks import callback_plugs
from rig.realtime.clock import VirtualClock
from sim_backend.drives.bus import DriveModel as Simulated
from sim_backend.drives.bus import Frame, SimulatedAdapter
from sim_backend.drives.can_simple import CanSimpleCommand
from sim_backend.drives.fdcanusb import Uart
from sim_backend.drives.moteus import MoteusOptions, SimulatedMoteus
from sim_backend.drives.multiplex import NOP
from sim_backend.drives.odrive import SimulatedOdrive
from sim_backend.drives.socket_can import CLASSIC_BYTES, FD_BYTES, SocketCan, from_wire, to_wire
from tests.conformance import drives
from tests.conformance.host import Host, StubLink
from tests.conformance.rigs import rotary_rig

UNIT_TWICE_NS = 125  # two units of device time
TRAVEL_NS = 80_000  # of a line, each way
CURRENT = 200  # quanta of 1 mA: 0.02 N·m at the handle, 0.01 at the output
MOTEUS_SETUP = {"servo.timeout_mode": "0"}
ODRIVE_SETUP = {odrive.WATCHDOG: "1", odrive.WATCHDOG_S: "0.005", odrive.HEARTBEAT_MS: "10"}
ODRIVE_SETUP |= dict.fromkeys((odrive.VELOCITY_LIMITED, odrive.OVERSPEED), "0")
ODRIVE_SETUP |= dict.fromkeys((odrive.ENCODER_MS, odrive.TORQUES_MS), "1")
ODRIVE_SETUP |= {f"axis0.config.can.{name}_msg_rate_ms": "20" for name in ("temperature", "bus_voltage")}
Way = Literal["to drive", "from drive"]
Strike = Callable[[bytes], bytes]


def bridged_rig(**changed: Any) -> RigModel:
    """Return `rotary_rig` with a drive's encoder, geared 1:2, its current loop's lag and its coarse current sensor."""
    model = rotary_rig(lag_s=1e-3, current_noise_a=0.005, **changed)
    encoder = Encoder(counts_per_revolution=4096, ratio=2.0, sign=model.encoder.sign, offset=0.0)
    return replace(model, encoder=encoder)


class MemoryBus:  # a rig.extras.drives.bus.Bus
    place, descriptor, checksum, is_socket, messages = "memory", -1, True, False, ()

    def __init__(self, drive: Simulated) -> None:
        self.drive = drive
        self.waiting: list[CanFrame] = []  # that wait, of others too
        self.sent = 0

    def send(self, frame: CanFrame) -> None:
        self.sent += 1
        replies = self.drive.run(self.drive.ticks + self.drive.rate_hz // 1000)
        replies += self.drive.receive(Frame(frame.id, frame.data, remote=frame.remote))
        self.waiting += [CanFrame(one.identifier, one.data) for one in replies]

    def receive(self, timeout_s: float) -> CanFrame | None:
        return self.waiting.pop(0) if self.waiting else None

    def close(self) -> None:
        pass


def find_moteus(drive: SimulatedMoteus, model: RigModel, number: int = 1) -> FittedDrive:
    """Return what a bridge reads from a moteus before it runs."""
    return moteus.fit(moteus.find(moteus.MoteusConversation(MemoryBus(drive), number), number), model)


def endpoints(firmware: tuple[int, int, int] = (0, 6, 11)) -> odrive.Endpoints:
    return odrive.Endpoints.of("flat_endpoints.json", SimulatedOdrive.flat_endpoints(firmware))


def write_endpoints(place: Path) -> Path:
    place.write_text(json.dumps(SimulatedOdrive.flat_endpoints()), encoding="utf-8")
    return place


def find_odrive(drive: SimulatedOdrive, model: RigModel, node: int = 0, numbers: Any = None) -> FittedDrive:
    talk = odrive.OdriveConversation(MemoryBus(drive), node, numbers or endpoints())
    return odrive.fit(odrive.find(talk), model)


class Moteus:
    """A moteus behind a bridge: the modes at rest, with torque and after its timeout, and its true values."""

    name, texts = "moteus", TEXTS["moteus"]
    rest, on, expired = 0, 10, 11
    stay_within = 13  # the mode of the wall that the drive renders itself

    def __init__(self, model: RigModel, settings: Mapping[str, str], switches: Mapping[str, str]) -> None:
        self.drive = SimulatedMoteus(model, MoteusOptions(settings={**MOTEUS_SETUP, **settings}))
        self.found = replace(find_moteus(self.drive, model), switches=moteus.switches_of(switches))

    def adapter(self, socket: bool) -> SimulatedAdapter:
        return SocketCan(fd=True, padding=NOP) if socket else Uart()

    def register(self, number: int) -> float:
        (answer,) = self.drive.receive(Frame(0xFF00 | 1, bytes((0x1D, number))))
        (value,) = struct.unpack_from("<f", answer.data, 2)
        return float(value)

    @property
    def mode(self) -> int:
        return round(self.register(0x000))

    @property
    def torque(self) -> float:
        """The torque that the drive commands now (N·m at its output)."""
        return self.register(0x03A) if self.mode in (self.on, self.stay_within) else 0.0

    @property
    def measured(self) -> float:
        """The torque that the drive measures (N·m at its output)."""
        return self.register(0x003)


class Odrive(drives.Odrive):
    """An ODrive behind a bridge; see `Moteus`."""

    name, texts = "odrive", TEXTS["odrive"]
    rest, on, expired = 1, 8, 1

    def __init__(self, model: RigModel, settings: Mapping[str, str], switches: Mapping[str, str]) -> None:
        assert not switches
        super().__init__(model, {**ODRIVE_SETUP, **settings})
        self.found = find_odrive(self.drive, model)

    def adapter(self, socket: bool) -> SimulatedAdapter:
        return SocketCan()

    @property
    def mode(self) -> int:
        return self.state

    @property
    def torque(self) -> float:
        """The torque that the drive commands now (N·m)."""
        return float(self.ask(CanSimpleCommand.GET_TORQUES, "ff")[0])

    @property
    def measured(self) -> float:
        """The torque that the drive measures (N·m)."""
        return float(self.ask(CanSimpleCommand.GET_TORQUES, "ff")[1])


KINDS: dict[str, type[Moteus | Odrive]] = {"moteus": Moteus, "odrive": Odrive}


class Bridged(StubLink):
    """A bridge, its drive and a line between them.

    `settings` are those of the drive where it is not as a bridge wants it, `drift` the share by which its clock is
    fast.
    """

    def __init__(
        self,
        model: RigModel | None = None,
        settings: Mapping[str, str] | None = None,
        *,
        kind: str = "moteus",
        travel_ns: int = TRAVEL_NS,
        switches: Mapping[str, str] | None = None,
        socket: bool = False,
        drift: float = 0.0,
    ) -> None:
        self.url = DeviceUrl(kind, "memory", {}, f"{kind}://memory")
        self.clock = VirtualClock()
        self.model = model or bridged_rig()
        self.far = KINDS[kind](self.model, settings or {}, switches or {})
        self.drive: Any = self.far.drive
        self.on_a_bus = socket or kind == "odrive"
        self.bridge = Bridge(self.model, self.far.found, socket=self.on_a_bus)
        self.adapter = self.far.adapter(socket)
        # way and number of a line → what becomes of it: another line, or b""
        self.strikes: dict[tuple[Way, int], Strike] = {}
        self.lines = {"to drive": 0, "from drive": 0}
        self.travel_ns = travel_ns
        self.alive = True
        self._began = self.drive.ticks
        self._ticks_per_ns = self.drive.rate_hz * (1.0 + drift) * 1e-9
        self._events: list[tuple[int, int, Way, bytes]] = []
        self._number = 0
        self._at_ns = 0  # to which the world has come
        self._sent = b""  # and not yet read by a loop
        self._undelivered: list[bytes] = []  # of the drive, while the bridge is not listening
        self._failure: BaseException | None = None
        self.bridge.start(0)

    # ------------------------------------------------------------------ a link

    def read(self, timeout_s: float) -> bytes:
        """Advance time until the bridge has sent something or the timeout has passed."""
        end_ns = self.clock.now_ns() + round(timeout_s * 1e9)
        sent, self._sent = self._sent, b""
        while not (sent := sent + self.bridge.to_host()) and self.clock.now_ns() < end_ns:
            self.step(end_ns)
        return sent

    def write(self, data: bytes) -> None:
        """Deliver bytes of the host now; its clock may have advanced without this object."""
        while self._at_ns < self.clock.now_ns():
            self.step(self.clock.now_ns())
        if self.alive:
            self._to_drive(self.bridge.receive_host(data, self._now))

    def port(self) -> LoopPort:
        plugs = callback_plugs(read=self._read_now, write=self.write, wait=self._wait, failed=self._failed)
        return LoopPort.on(self.clock, **plugs._asdict())

    def _failed(self, failure: BaseException) -> None:
        self._failure = self._failure or failure

    def _wait(self, deadline_ns: int) -> bool:
        self._sent += self.bridge.to_host()
        while not self._sent and self.clock.now_ns() < deadline_ns:
            self.step(deadline_ns)
            self._sent = self.bridge.to_host()
        return bool(self._sent)

    def _read_now(self, size: int) -> bytes:
        data, self._sent = self._sent[:size], self._sent[size:]
        return data

    def failure(self) -> BaseException | None:
        return self._failure

    # ------------------------------------------------------------------ time

    @property
    def _now(self) -> int:
        return self._at_ns * 2 // UNIT_TWICE_NS

    def run(self, seconds: float) -> None:
        """Advance time; what the bridge sends is read later."""
        end_ns = self.clock.now_ns() + round(seconds * 1e9)
        while self.clock.now_ns() < end_ns:
            self.step(end_ns)

    def sleep(self, seconds: float) -> None:
        """Suspend the bridge's computer; it receives afterwards what arrived meanwhile."""
        self.alive = False
        self.run(seconds)
        self.alive = True
        for line in self._undelivered:
            self._to_drive(self.bridge.receive_bus(line, self._now))
        self._undelivered.clear()

    def step(self, end_ns: int) -> None:
        times = [end_ns, self._events[0][0] if self._events else end_ns, self._next_send_ns(end_ns)]
        if self.alive:
            times.append(-(-self.bridge.due * UNIT_TWICE_NS // 2))
        next_ns = self._at_ns = max(self._at_ns, min(times))
        self.clock.sleep_until(next_ns)
        self._from_drive(self.drive.run(self._began + int(next_ns * self._ticks_per_ns + 1e-6)))
        while self._events and self._events[0][0] <= next_ns:
            _, _, way, line = heapq.heappop(self._events)
            if way == "to drive":
                self._deliver(line)
            elif self.alive:
                self._to_drive(self.bridge.receive_bus(line, self._now))
            else:
                self._undelivered.append(line)
        if self.alive:
            self._to_drive(self.bridge.receive_host(b"", self._now))
        if self.alive and self.bridge.due <= self._now:
            self._to_drive(self.bridge.tick(self._now))

    def _next_send_ns(self, otherwise_ns: int) -> int:
        """Return when the drive will send something without a request."""
        due = getattr(self.drive, "next_due", None)
        if due is None:
            return otherwise_ns
        return math.ceil((due - self._began) / self._ticks_per_ns)

    def _to_drive(self, sent: bytes) -> None:
        size = CLASSIC_BYTES if self.far.name == "odrive" else FD_BYTES
        frames = range(0, len(sent), size) if self.on_a_bus else ()
        for line in [sent[at : at + size] for at in frames] or sent.splitlines(keepends=True):
            self._send("to drive", line)

    def _from_drive(self, frames: list[Frame]) -> None:
        for frame in frames:
            for unit in self.adapter.close(frame):
                self._send("from drive", to_wire(unit) if self.on_a_bus else unit)

    def _send(self, way: Way, line: bytes) -> None:
        strike = self.strikes.get((way, self.lines[way]))
        self.lines[way] += 1
        line = line if strike is None else strike(line)
        if line:
            self._number += 1
            heapq.heappush(self._events, (self._at_ns + self.travel_ns, self._number, way, line))

    def _deliver(self, line: bytes) -> None:
        frame, sent = self.adapter.open(from_wire(line) if self.on_a_bus else line)
        for one in sent:
            self._send("from drive", one)
        if frame is not None:
            self._from_drive(self.drive.receive(frame))

    def strike(self, way: Way, strike: Strike, lines: int = 10_000, after: int = 0) -> None:
        """Change the next lines, after some that pass."""
        begin = self.lines[way] + after
        self.strikes = {(way, number): strike for number in range(begin, begin + lines)}

    def happen(self, name: str, value: float = 0.0) -> None:
        self._from_drive(self.drive.happen(name, value))

    # ------------------------------------------------------------------ what is true

    @property
    def mode(self) -> int:
        return self.far.mode

    @property
    def torque(self) -> float:
        """The torque that the drive commands now (N·m at its output)."""
        return self.far.torque


def plain_drive() -> FittedDrive:
    names = {"kind": "moteus", "firmware": "moteus"}
    return FittedDrive(**names, id=1, counts_per_turn=16384.0, transmission=2.0, ranges={}, settings={})


def armed(world: Bridged | None = None, **values: int) -> tuple[Bridged, Host]:
    world = world or Bridged()
    host = Host(world)
    host.begin(**values)
    return world, host


def push(host: Host, ticks: int, current: int = CURRENT) -> None:
    for _ in range(ticks):
        host.next_state()
        host.command(current)


def push_until_fault(host: Host, ticks: int, current: int = CURRENT) -> m.State:
    """Reply to at most this many STATEs with a current, until one reports a fault; return the last."""
    for _ in range(ticks):
        state = host.next_state()
        if state.fault:
            break
        host.command(current)
    return state
