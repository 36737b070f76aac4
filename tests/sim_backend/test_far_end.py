"""The compiled far end of a loop sends the same bytes and moves as the readable device does, at the same times."""

import errno
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.errors import LocalProtocolError
from firmware_protocol.faults import Fault
from firmware_protocol.messages import Mode
from rig.devices.device import DeviceUrl
from rig.devices.fault_script import Faults
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.ends import far_end
from sim_backend.ends import link as links
from sim_backend.ends.link import BUFFER_BYTES, MemoryLink
from tests.conformance import host as hosts
from tests.conformance.firmware import hide_compiler, need_compiler
from tests.conformance.host import RUN_PARAMETERS, Host
from tests.conformance.link import COMPILED, check_link, give, listen
from tests.conformance.rigs import rotary_rig

pytestmark = pytest.mark.skipif(not COMPILED, reason="function types need the compiler")

RATE = 2_000
TICK_S = 1.0 / RATE


class ThroughThePort:
    """A link as the compiled loop uses it: every byte passes through the compiled port functions."""

    def __init__(self, link: MemoryLink) -> None:
        self.link, self.clock = link, link.clock
        self.port = link.port()
        self.log: list[tuple[int, bytes]] = []

    def write(self, data: bytes) -> None:
        assert give(self.port.write, self.port.handle, np.frombuffer(data, np.uint8).copy()) == len(data)

    def read(self, timeout_s: float) -> bytes:
        into = np.zeros(BUFFER_BYTES, np.uint8)
        until_ns = self.clock.now_ns() + round(timeout_s * 1e9)
        size = listen(self.port.read, self.port.wait, self.port.handle, into, until_ns)
        assert size >= 0, f"errno {-size}, {self.link.failure()}"
        received = into[:size].tobytes()
        self.log.append((self.clock.now_ns(), received))
        return received


def fresh(**options: Any) -> MemoryLink:
    return MemoryLink(FirmwareDevice(rotary_rig(current_noise_a=0.002), law_maximum=0, **options))


def three_links() -> list[ThroughThePort]:
    """Return the compiled far end, the firmware behind callbacks, and the readable device behind callbacks."""
    rig = rotary_rig(current_noise_a=0.002)
    return [
        ThroughThePort(fresh()),
        ThroughThePort(MemoryLink(FirmwareDevice(rig, law_maximum=0), Faults())),
        ThroughThePort(MemoryLink(SimulatedDevice(rig))),
    ]


def walk(wire: ThroughThePort, steps: list[tuple[str, int]]) -> None:
    hosts._dictionaries.clear()  # each reads it, the first one too
    host = Host(wire)  # type: ignore[arg-type]
    host.begin(position_rate=RATE)
    for session, (step, number) in enumerate(steps, start=2):
        with suppress(LocalProtocolError):  # what the device's state forbids is not sent
            take(step, number, wire, host, session)


def take(step: str, number: int, wire: ThroughThePort, host: Host, session: int) -> None:
    if step == "command":
        host.command(number, lifetime_us=abs(number) * 10)
    elif step == "stop":
        host.command(mode=Mode.STOP)
    elif step == "wait":
        list(host.events(abs(number) * 1e-5))
    elif step == "sleep":
        wire.clock.sleep_until(wire.clock.now_ns() + abs(number) * 10_007)
    elif step == "ask":
        host.ask(m.GetTime(host.nonce(), 0))
    elif step == "push":  # Python has the device in between
        wire.link.device.hardware.external_effort = number * 1e-3
    elif step == "press":
        wire.link.device.press_emergency_stop(number > 0)
    elif step == "again":
        host.disarm(clear_fault=True)
        host.configure(**{**RUN_PARAMETERS, "position_rate": RATE + abs(number)})
        host.arm(session, host.configure(**RUN_PARAMETERS).crc)


STEPS = ("command", "command", "wait", "wait", "sleep", "stop", "ask", "push", "press", "again")


@settings(max_examples=3)  # a tenth of a second each
@given(st.lists(st.tuples(st.sampled_from(STEPS), st.integers(-400, 400)), max_size=30))
@example(
    [("command", 300), ("wait", 50), ("stop", 0), ("wait", 100), ("again", 7), ("command", 90), ("wait", 99)]
)
@example([("command", 300), ("sleep", 400), ("sleep", 400), ("wait", 1), ("again", -300), ("wait", 300)])
def test_compiled_far_end_sends_and_moves_as_the_readable_device(steps: list[tuple[str, int]]) -> None:
    wires = three_links()
    for wire in wires:
        walk(wire, steps)
    *others, readable = [
        (
            *(wire.log, wire.link.truth().tobytes(), wire.clock.now_ns(), wire.link.discarded),
            *(wire.link.device.time, wire.link.device.current, wire.link.device.fault),
        )
        for wire in wires
    ]
    assert others == [readable] * 2


def test_it_conforms_as_a_link() -> None:
    check_link(fresh, fresh)


def test_unread_bytes_are_dropped_and_counted() -> None:
    wires = three_links()
    for wire in wires:
        host = Host(wire)  # type: ignore[arg-type]
        host.begin(position_rate=RATE)
        wire.clock.sleep_until(wire.clock.now_ns() + 1_000_000_000)
        wire.read(0.0)
    assert [wire.log for wire in wires] == [wires[0].log] * 3
    assert [wire.link.discarded for wire in wires] == [wires[0].link.discarded] * 3
    assert wires[0].link.discarded > 0


def test_a_change_that_python_makes_is_seen_by_ticks_that_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(far_end, "LONGEST_RUN", 200)
    wire = ThroughThePort(fresh())
    device = wire.link.device
    host = Host(wire)  # type: ignore[arg-type]
    host.begin(position_rate=RATE)
    host.next_state()
    device.press_emergency_stop()
    device.hardware.external_effort = 0.1
    for _ in range(201):
        list(host.events(TICK_S))
    assert host.states[1].fault == Fault.EMERGENCY_STOP
    before, after = wire.link.truth()["velocity_true"][[1, -1]]
    assert abs(after) > abs(before)


@pytest.mark.parametrize("number", range(3))
def test_an_exception_inside_is_eio_and_kept_as_the_links_failure(number: int) -> None:
    wire = three_links()[number]
    Host(wire).begin(position_rate=RATE)  # type: ignore[arg-type]
    wire.link.device.hardware.external_effort = "no number"
    into = np.zeros(64, np.uint8)
    got = listen(wire.port.read, wire.port.wait, wire.port.handle, into, wire.clock.now_ns() + 10**9)
    assert got == -errno.EIO
    assert isinstance(wire.link.failure(), TypeError)


def test_a_closed_one_is_eio() -> None:
    wire = ThroughThePort(fresh())
    wire.link.close()
    assert give(wire.port.write, wire.port.handle, np.zeros(1, np.uint8)) == -errno.EIO
    into = np.zeros(8, np.uint8)
    assert listen(wire.port.read, wire.port.wait, wire.port.handle, into, 10**9) == -errno.EIO
    assert wire.link.failure() is None


def test_without_compiler_the_readable_device_stands_in_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    url = DeviceUrl.parse("sim://test")
    link = links.open_link(url, rotary_rig())
    assert isinstance(link.device, FirmwareDevice)
    assert not link.messages
    hide_compiler(monkeypatch)
    link = links.open_link(url, rotary_rig())
    assert isinstance(link.device, SimulatedDevice)
    (message,) = link.messages
    assert "there is no C compiler" in message
    assert "pip install ziglang" in message
