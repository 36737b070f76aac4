"""The compiled timer of a simulated board against the readable device, in virtual time behind a scripted port."""

import errno
import itertools
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from firmware_protocol.framing import FrameSplitter
from firmware_protocol.packing import unpack
from rig.devices.port import LoopPort
from rig.realtime.callbacks import callback_plugs
from rig.realtime.clock import VirtualClock
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.ends.board_time import LONGEST_PAUSE_NS, PENDING_BYTES, BoardTime
from sim_backend.ends.link import MemoryLink
from tests.conformance.firmware import need_compiler
from tests.conformance.host import Host
from tests.conformance.link import COMPILED
from tests.conformance.rigs import rotary_rig
from tests.conformance.tiers import first_by_default

pytestmark = pytest.mark.skipif(not COMPILED, reason="function types need the compiler")

RATE = 1_000
TICK_NS = 1_000_000_000 // RATE
ANSWERED_NS = 300_000  # after the sample
RIG = rotary_rig(current_noise_a=0.002)
Sent = list[tuple[int, bytes]]


@pytest.fixture(autouse=True)
def _compiler() -> None:
    need_compiler()


class ScriptedPort:
    """A host that sends bytes at given times, on a clock that jumps.

    `late`: delay of a wait after its deadline (ns); in `gone` the port is closed; in `full` it accepts nothing.
    """

    def __init__(self, script: Sent, late: Callable[[int], int] = lambda deadline_ns: 0) -> None:
        self.clock = VirtualClock()
        self.sent: Sent = []
        self.gone: range = range(0)
        self.full: range = range(0)
        self._script = list(script)
        self._late = late

    def loop_port(self) -> LoopPort:
        plugs = callback_plugs(read=self._read, write=self._write, wait=self._wait)
        return LoopPort.on(self.clock, **plugs._asdict())

    def _wait(self, deadline_ns: int) -> bool:
        now_ns = self.clock.now_ns()
        if now_ns in self.gone:
            raise OSError(errno.EIO, "the port is closed")
        if self._script and self._script[0][0] <= max(now_ns, deadline_ns):
            self.clock.sleep_until(self._script[0][0])
            return True
        if deadline_ns > now_ns:
            self.clock.sleep_until(deadline_ns + self._late(deadline_ns))
        return False

    def _read(self, size: int) -> bytes:
        return self._script.pop(0)[1]

    def _write(self, data: bytes) -> int:
        now_ns = self.clock.now_ns()
        if now_ns in self.full:
            return 0
        self.sent.append((now_ns, data))
        return len(data)

    def states(self) -> list[m.State]:
        found = [unpack(frame)[1] for frame in FrameSplitter().feed(b"".join(data for _, data in self.sent))]
        return [message for message in found if isinstance(message, m.State)]


def conversation(commands: int) -> Sent:
    """Return the host's bytes with their times: it configures, arms, and answers `commands` STATEs a little late."""

    class Noted(MemoryLink):
        def write(self, data: bytes) -> None:
            script.append((self.clock.now_ns() + ANSWERED_NS, data))
            super().write(data)

    script: Sent = []
    host = Host(Noted(SimulatedDevice(RIG, position_rate_default=RATE)))
    list(host.events(0.01))
    host.begin()
    for number in range(commands):
        list(host.events(1.0))
        host.command(number % 40 - 20)
    return script


def reference(script: Sent, until_ns: int) -> Sent:
    """Return the bytes that the readable device sends for the same input, with their times."""
    device = SimulatedDevice(RIG, position_rate_default=RATE, keep_truth=False)
    sent: Sent = []
    for at_ns, data in [*script, (until_ns, b"")]:
        while device.next_tick_ns <= at_ns and device.next_tick_ns <= until_ns:
            sent.append((device.next_tick_ns, device.tick()))
        if at_ns < until_ns:
            sent.append((at_ns, device.receive(data, received_at=at_ns * 2 // 125)))
    return [(at_ns, data) for at_ns, data in sent if data]


def run(port: ScriptedPort, duration_s: float, **options: Any) -> FirmwareDevice:
    """Run the firmware behind a port for some seconds and return its device."""
    device = FirmwareDevice(RIG, law_maximum=0, position_rate_default=RATE, keep_truth=False)
    BoardTime(device, port.loop_port(), threading.Event(), **options).run(duration_s)
    return device


def join_by_time(sent: Sent) -> Sent:
    """Join the bytes that were sent at the same time."""
    found: dict[int, bytes] = {}
    for at_ns, data in sent:
        found[at_ns] = found.get(at_ns, b"") + data
    return list(found.items())


@pytest.mark.parametrize("most", first_by_default([7, 1, 1 << 62]))
def test_firmware_sends_the_bytes_of_the_readable_device_at_the_same_times(most: int) -> None:
    script = conversation(150)
    port = ScriptedPort(script)
    until_ns = script[-1][0] + 5 * TICK_NS
    device = run(port, until_ns * 1e-9, most=most)
    assert join_by_time(port.sent) == join_by_time(reference(script, until_ns))
    assert device.state == State.RUNNING


def test_late_process_skips_no_tick_and_keeps_its_grid() -> None:
    def late(deadline_ns: int) -> int:
        return 5 * TICK_NS if deadline_ns // TICK_NS % 50 == 0 else 20_000

    script = conversation(300)
    port = ScriptedPort(script, late)
    device = run(port, script[-1][0] * 1e-9)
    states = port.states()
    indices = [state.sample_index for state in states[-200:]]
    assert indices == list(range(indices[0], indices[0] + 200))
    assert states[-1].missed_ticks == 0
    assert abs(device.elapsed_ns - port.clock.now_ns()) < 6 * TICK_NS


def test_late_ticks_are_caught_up_singly_with_time_for_a_reply() -> None:
    script = conversation(100)
    stopped_ns = script[-50][0] // TICK_NS * TICK_NS
    port = ScriptedPort(script[:-50], lambda deadline_ns: 8 * TICK_NS if deadline_ns == stopped_ns else 0)
    run(port, stopped_ns * 1e-9 + 0.02)
    after = [at_ns for at_ns, _ in port.sent if at_ns > stopped_ns]
    assert len(after) >= 20
    assert min(b - a for a, b in itertools.pairwise(after)) >= TICK_NS // 2
    assert after[0] > stopped_ns + 8 * TICK_NS, "a host that was stopped at the same time runs first"


def test_a_long_pause_passes_in_neither_world() -> None:
    pause_ns = 3600 * LONGEST_PAUSE_NS
    port = ScriptedPort([], lambda deadline_ns: pause_ns if deadline_ns == 20 * TICK_NS else 0)
    device = run(port, 0.1)
    assert device.elapsed_ns <= 20 * TICK_NS
    port = ScriptedPort([], lambda deadline_ns: pause_ns if deadline_ns == 20 * TICK_NS else 0)
    device = run(port, pause_ns * 1e-9 + 0.1)
    assert 90 * TICK_NS < device.elapsed_ns < 110 * TICK_NS


def test_closed_port_is_a_lost_link_and_the_next_host_finds_an_empty_line() -> None:
    script = conversation(100)
    gone_ns = script[-1][0] + ANSWERED_NS
    port = ScriptedPort(script)
    port.gone = range(gone_ns, gone_ns + 100 * TICK_NS)
    hung_up: list[int] = []
    device = run(port, gone_ns * 1e-9 + 0.15, hung_up=lambda: hung_up.append(port.clock.now_ns()))
    assert len(hung_up) == 1
    assert device.fault == Fault.LINK_LOST
    assert device.current == 0
    assert not [at_ns for at_ns, _ in port.sent if gone_ns + TICK_NS < at_ns < port.gone.stop]
    after = [at_ns for at_ns, _ in port.sent if at_ns >= port.gone.stop]
    assert len(after) >= 40


def test_unread_frames_are_dropped_whole_and_newest_first() -> None:
    script = conversation(10)
    full_ns = script[-1][0]
    port = ScriptedPort(script)
    port.full = range(full_ns, full_ns + 4000 * TICK_NS)
    run(port, full_ns * 1e-9 + 4.1)
    at_once = next(data for at_ns, data in port.sent if at_ns >= port.full.stop)
    assert PENDING_BYTES - 100 < len(at_once) <= PENDING_BYTES
    splitter = FrameSplitter()
    indices = [unpack(frame)[1].sample_index for frame in splitter.feed(at_once)]
    assert indices == list(range(indices[0], indices[0] + len(indices)))


def test_stop_event_ends_the_timer_after_the_elapsed_ticks() -> None:
    port = ScriptedPort(conversation(10))
    stop = threading.Event()
    device = FirmwareDevice(RIG, law_maximum=0, position_rate_default=RATE, keep_truth=False)
    stopped: list[int] = []

    def late(deadline_ns: int) -> int:
        if deadline_ns >= 50 * TICK_NS and not stopped:
            stopped.append(port.clock.now_ns())
            stop.set()
        return 0

    port._late = late
    BoardTime(device, port.loop_port(), stop).run(None)
    assert port.clock.now_ns() <= stopped[0] + 12 * TICK_NS
    assert device.elapsed_ns >= stopped[0] - TICK_NS


ANNOUNCED = """
from rig.core import program; program.begin()
import sys
from rig import config
from rig.config import presets
from rig.realtime.kernel import Kernel
from sim_backend.ends.pty import serve

announced, late, prepare = [], [], Kernel.prepare

def noted(kernel):
    if announced and not kernel.prepared:
        late.append(kernel.__name__)
    prepare(kernel)

Kernel.prepare = noted
changes = {"trial.kind": "human", "operator.grip": "normal"} if sys.argv[1] == "held" else {}
experiment = config.override(presets.load("koul-compliant"), changes, "test")
serve(config.rig_model(experiment), announce=announced.append, duration_s=0.1)
print(len(announced), late, "scipy.linalg" in sys.modules)
"""


@pytest.mark.parametrize("hand", first_by_default(["held", "free"]))
def test_nothing_compiles_once_a_host_can_open_the_port(hand: str) -> None:
    """A host reports a lost link after a second without reply; loading linear algebra alone takes 0.1 s."""
    done = subprocess.run(
        [sys.executable, "-c", ANNOUNCED, hand], capture_output=True, text=True, timeout=100, check=False
    )
    assert (done.stdout, done.stderr) == ("1 [] False\n", "")
