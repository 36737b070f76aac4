"""The in-memory link: virtual time in lock-step, and scripted faults of the line."""

import errno
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.connection import Connection
from rig.core.errors import ConfigError
from rig.devices.device import DeviceUrl
from rig.devices.fault_script import Direction, FaultKind, Faults, FrameFault
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.ends.channel import ScriptedLine
from sim_backend.ends.link import MemoryLink, open_link
from tests.conformance.host import Host
from tests.conformance.link import COMPILED, check_link, give, listen
from tests.conformance.rigs import rotary_rig
from tests.conformance.tiers import first_by_default

RATE = 2_000
TICK_S = 1.0 / RATE
CURRENT = 100
TO_DEVICE, TO_HOST = Direction.TO_DEVICE, Direction.TO_HOST
needs_compiler = pytest.mark.skipif(not COMPILED, reason="function types need the compiler")


def fresh(faults: Faults | None = None, **device: Any) -> MemoryLink:
    return MemoryLink(SimulatedDevice(rotary_rig(current_noise_a=0.002), **device), faults)


# ---------------------------------------------------------------------- the contract


def test_the_link_conforms() -> None:
    check_link(fresh, fresh)  # in BOOT a device says nothing unasked


def test_a_silenced_link_conforms_as_the_silent_one() -> None:
    dead = FrameFault(kind=FaultKind.SILENCE, direction=TO_DEVICE, frame=0, both=True)
    check_link(fresh, lambda: fresh(Faults((dead,))))


@settings(max_examples=15)
@given(st.lists(st.sampled_from(["command", "idle", "sleep", "ask"]), max_size=40))
def test_the_device_never_passes_a_sample_before_the_answer_to_it_is_delivered(steps: list[str]) -> None:
    link = fresh()
    host = Host(link)
    host.begin(position_rate=RATE)
    current = 0
    for number, step in enumerate(steps):
        state = host.next_state()
        assert state.sample_index == link.device.sample_index
        assert state.current_commanded == current
        assert 0 <= link.clock.now_ns() - link.device.elapsed_ns < TICK_S * 1e9
        if step == "command":
            current = number
            host.command(current)
        elif step == "ask":
            stamp = host.ask(m.GetTime(host.nonce(), 0)).device_sent
            assert link.device.time <= stamp == link.clock.now_ns() * 2 // 125, "between the ticks too"
        elif step == "sleep":
            link.clock.sleep_until(link.clock.now_ns() + round(1.5 * TICK_S * 1e9))


def test_waiting_jumps_to_the_deadline_and_no_further() -> None:
    link = fresh()
    host = Host(link)
    host.begin(position_rate=RATE)
    host.next_state()
    now_ns = link.clock.now_ns()
    assert link.read(0.4 * TICK_S) == b""
    assert link.clock.now_ns() == now_ns + 200_000
    assert link.read(0.4 * TICK_S) == b""
    assert link.read(0.4 * TICK_S) != b""
    assert link.clock.now_ns() == now_ns + 500_000


# ---------------------------------------------------------------------- opening by URL


def test_a_url_opens_a_device_as_its_options_say() -> None:
    url = DeviceUrl.parse("sim://test?seed=3&initial_position=0.01&offset=0.25&position_rate_maximum=9000")
    link = open_link(url, rotary_rig())
    assert link.url == url
    host = Host(link)
    assert host.identify().position_rate_maximum == 9_000
    resolution = rotary_rig().encoder.resolution
    assert host.next_state().count == np.floor(0.01 / resolution + 0.25)


@pytest.mark.parametrize(
    ("url", "text"),
    [
        ("sim://test?sed=3", "unknown option 'sed'.*known options: seed, initial_position"),
        ("sim://test?seed=x", "seed = 'x' is not a whole number"),
        ("sim://test?seed=-1", "seed = -1 is out of range"),
        ("sim://test?offset=1.0", "offset = 1.0 is out of range"),
        ("sim://test?initial_position=nan", "initial_position = nan is out of range"),
        ("sim://test?position_rate_maximum=100", "default rate of 1000 Hz is outside 1 … 100 Hz"),
    ],
)
def test_a_wrong_option_is_refused_by_name(url: str, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        open_link(DeviceUrl.parse(url), rotary_rig())


# ---------------------------------------------------------------------- the compiled loop's side


@needs_compiler
def test_the_loop_reads_no_more_than_it_has_room_for() -> None:
    link = fresh()
    host = Host(link)
    host.begin(position_rate=RATE)
    link.elapse(10 * TICK_S)
    port = link.port()
    stream = b""
    for size in (1, 7, 40, 10_000):
        into = np.zeros(size, np.uint8)
        got = listen(port.read, port.wait, port.handle, into, link.clock.now_ns())
        assert 0 < got <= size
        stream += into[:got].tobytes()
    host.connection.receive_data(stream)
    indices = []
    while (event := host.connection.next_event()) is not None:
        indices.append(event.message.sample_index)  # type: ignore[union-attr]
    assert len(indices) == 10
    assert np.all(np.diff(indices) == 1)


@needs_compiler
def test_an_unplugged_line_is_eio_for_the_loop_and_no_failure_of_the_simulation() -> None:
    link = fresh(Faults((FrameFault(kind=FaultKind.UNPLUG, direction=TO_DEVICE, frame=0),)))
    port = link.port()
    frame = Connection(m.Role.HOST).send(m.Identify(1, 0))
    assert give(port.write, port.handle, np.frombuffer(frame, np.uint8).copy()) == -errno.EIO
    assert listen(port.read, port.wait, port.handle, np.zeros(8, np.uint8), 10**9) == -errno.EIO
    assert link.failure() is None


# ---------------------------------------------------------------------- faults on the line


def line_of(kind: FaultKind, frame: int, **others: Any) -> ScriptedLine:
    return ScriptedLine([FrameFault(kind=kind, direction=TO_HOST, frame=frame, **others)])


def send_through(line: ScriptedLine, frames: list[bytes]) -> list[bytes]:
    """Return the bytes received in each tick when frame k is sent in tick k."""
    out = []
    for tick, frame in enumerate(frames):
        line.send(TO_HOST, frame, tick)
        out.append(line.receive(TO_HOST, tick))
    return out


FRAMES = [bytes([k + 1]) * 4 + b"\0" for k in range(5)]
A, B, C, D, E = FRAMES


@pytest.mark.parametrize(
    ("line", "out"),
    [
        (ScriptedLine(), [A, B, C, D, E]),
        (line_of(FaultKind.DROP, 1), [A, b"", C, D, E]),
        (line_of(FaultKind.CORRUPT, 1, byte=7, bit=6), [A, b"\2\2\x42\2\0", C, D, E]),
        (line_of(FaultKind.CORRUPT, 1, byte=4), [A, b"\2\2\2\2\1", C, D, E]),
        (line_of(FaultKind.DUPLICATE, 1), [A, B + B, C, D, E]),
        (line_of(FaultKind.REORDER, 1), [A, b"", C + B, D, E]),
        (line_of(FaultKind.TRUNCATE, 1, byte=2), [A, b"\2\2", C, D, E]),
        (line_of(FaultKind.DELAY, 1, ticks=2), [A, b"", b"", B + C + D, E]),
        (line_of(FaultKind.SILENCE, 1), [A, b"", b"", b"", b""]),
        (line_of(FaultKind.UNPLUG, 1), [A, b"", b"", b"", b""]),
        (ScriptedLine([FrameFault(kind=FaultKind.DROP, direction=TO_DEVICE, frame=1)]), [A, B, C, D, E]),
        (ScriptedLine([FrameFault(kind=FaultKind.DROP, direction=TO_HOST, tick=3)]), [A, B, C, b"", E]),
    ],
    ids=["none", "drop", "corrupt", "corrupt-end", "duplicate", "reorder", "truncate", "delay", "silence",
         "unplug", "other-direction", "from-a-tick-on"],
)  # fmt: skip
def test_a_fault_does_what_it_says_to_its_frame_and_no_other(line: ScriptedLine, out: list[bytes]) -> None:
    assert send_through(line, FRAMES) == out


def test_bytes_in_pieces_are_frames_all_the_same() -> None:
    line = line_of(FaultKind.DROP, 1)
    whole = b"".join(FRAMES)
    out = send_through(line, [b"\0"] + [whole[k : k + 3] for k in range(0, len(whole), 3)])
    assert b"".join(out) == A + C + D + E
    assert line.frames[TO_HOST] == 5
    assert line.acted == {FaultKind.DROP: 1}


def test_faults_on_one_frame_act_one_after_the_other() -> None:
    faults = [
        FrameFault(kind=kind, direction=TO_HOST, frame=0, ticks=3)
        for kind in (FaultKind.DUPLICATE, FaultKind.DELAY)
    ]
    assert send_through(ScriptedLine(faults), FRAMES) == [b"", b"", b"", A + A + B + C + D, E]


def test_delayed_frame_arrives_at_its_tick_on_an_idle_line() -> None:
    link = fresh(Faults((FrameFault(kind=FaultKind.DELAY, direction=TO_DEVICE, frame=0, ticks=500),)))
    tick_s = link.device.next_tick_ns * 1e-9
    link.write(Connection(m.Role.HOST).send(m.Identify(1, 0)))
    link.elapse(499.5 * tick_s)
    assert link.read(0.0) == b""
    link.elapse(tick_s)
    assert link.read(0.0) != b""


# ---------------------------------------------------------------------- a clock that drifts


@pytest.mark.parametrize("make", [SimulatedDevice, FirmwareDevice])
@pytest.mark.parametrize("ppm", first_by_default([-200.0, 1000.0, -0.001, 0.0, 50.0, 200.0]))
def test_the_device_ticks_by_its_own_clock(ppm: float, make: Callable[..., Any]) -> None:
    link = MemoryLink(make(rotary_rig(), position_rate_default=7_000), clock_ppm=ppm)
    for _ in range(20):
        link.elapse(0.1)
    exact_ns = 2e9 * (1 + ppm * 1e-6)
    assert exact_ns - 1e9 / 7_000 - 63 <= link.device.elapsed_ns <= exact_ns + 1e-3
    assert link.device.next_tick_ns > exact_ns - 63


def test_stamps_lie_between_the_ticks() -> None:
    link = MemoryLink(SimulatedDevice(rotary_rig(), position_rate_default=1_000), clock_ppm=100.0)
    host = Host(link)
    host.identify()
    for at_ns in (1_234_567, 400_000_000, 1_000_000_001):
        link.clock.sleep_until(at_ns)
        reply = host.ask(m.GetTime(host.nonce(), 0))
        true = at_ns * 1.0001 / 62.5
        assert true - 1 <= reply.device_received <= reply.device_sent <= true + 1e-6


@pytest.mark.parametrize("text", ["clock_ppm=1001", "clock_ppm=nan", "clock_ppm=fast"])
def test_a_clock_that_no_crystal_has_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="clock_ppm"):
        open_link(DeviceUrl.parse(f"sim://test?{text}"), rotary_rig())


def test_the_clock_of_a_url_reaches_the_device() -> None:
    link = open_link(DeviceUrl.parse("sim://test?clock_ppm=-500"), rotary_rig())
    link.elapse(10.0)
    assert link.device.elapsed_ns == pytest.approx(10e9 * (1 - 500e-6), abs=1e6)
