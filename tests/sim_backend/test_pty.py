"""The simulated rig as a process behind a pseudo-terminal, in real time: waits are bounded, latency is not asserted."""

import os
import signal
import time
import tty
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from firmware_protocol import messages as m
from firmware_protocol.framing import FrameSplitter
from firmware_protocol.packing import unpack
from rig.core.errors import ConfigError
from rig.devices.device import DeviceUrl
from rig.devices.serial import SerialLink, open_link
from sim_backend.ends import pty
from sim_backend.ends.line import PENDING_BYTES, PseudoTerminal
from tests.conformance.device import check_device
from tests.conformance.firmware import need_compiler
from tests.conformance.host import Host
from tests.conformance.link import check_link
from tests.conformance.rigs import rotary_rig
from tests.conformance.served import served_rig
from tests.conformance.started import WAIT_S
from tests.conformance.tiers import first_by_default

SLACK_S = 5.0  # of a loaded machine


def open_port(path: str) -> SerialLink:
    return open_link(DeviceUrl.parse(f"serial://{path}"))


@pytest.fixture(params=first_by_default([True, False]), ids=["firmware", "readable"])
def firmware(request: pytest.FixtureRequest) -> bool:
    if request.param:
        need_compiler()
    return bool(request.param)


@pytest.fixture
def path(firmware: bool) -> Iterator[str]:
    with served_rig(firmware=firmware) as served:
        yield served


def run(host: Host, states: int) -> list[m.State]:
    """Answer every STATE until there are `states` of them, and return them."""
    end = time.monotonic() + WAIT_S
    host.states.clear()
    while len(host.states) < states:
        assert time.monotonic() < end
        list(host.events(0.1))
        host.command(20)
    return host.states


@pytest.mark.quiet
def test_the_process_conforms_as_a_device(path: str) -> None:
    check_device(lambda: open_port(path), starts_in_boot=False)


def test_its_port_conforms_as_a_link(path: str) -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        check_link(lambda: open_port(path), lambda: open_port(os.ttyname(slave)), slack_s=SLACK_S)
    finally:
        os.close(master)
        os.close(slave)


def test_it_advertises_the_rates_that_a_pseudo_terminal_carries(path: str, firmware: bool) -> None:
    about = Host(open_port(path)).identify()
    assert about.position_rate_default == 1_000
    assert about.position_rate_maximum == (20_000 if firmware else 4_000)
    law = about.parameter("law")
    assert law is not None
    assert law.maximum == (2 if firmware else 0)


def test_samples_come_in_order_and_answers_act_a_tick_later_at_the_soonest(path: str, firmware: bool) -> None:
    host = Host(open_port(path))
    host.begin()
    states = run(host, 100)
    host.disarm()
    host.link.close()
    for before, after in pairwise(states):
        ticks = after.sample_index - before.sample_index
        assert ticks > 0
        assert after.device_time - before.device_time == 16_000 * ticks
        assert after.missed_ticks >= before.missed_ticks
    running = [state for state in states if state.command_age != 0xFFFF]
    assert min(state.command_age for state in running) >= 1
    # The first STATE went out before any command; the readable device reads at its ticks, and the second already ran
    # when the answer came.
    early = states[:1] if firmware else states[:2]
    assert {state.current_commanded for state in early} == {0}
    assert 20 in {state.current_commanded for state in states}


def test_host_that_does_not_read_gets_whole_frames_in_order() -> None:
    with PseudoTerminal() as line:
        host = os.open(line.place, os.O_RDWR | os.O_NOCTTY)
        for number in range(1000):
            line.write_if_free(number.to_bytes(2, "little") * 22)
        assert len(line._pending) < 44
        received = os.read(host, 1 << 16)
        while line._pending or len(received) % 44:
            line.write(b"")
            received += os.read(host, 1 << 16)
        for _ in range(1000):
            line.write(bytes(44))
        assert len(line._pending) <= PENDING_BYTES
        os.close(host)
    assert len(received) < 1000 * 44
    frames = [received[at : at + 44] for at in range(0, len(received), 44)]
    numbers = [int.from_bytes(frame[:2], "little") for frame in frames]
    assert frames == [number.to_bytes(2, "little") * 22 for number in numbers]
    # The kernel moves what it holds to the host when it likes, and then has room for later frames.
    assert (numbers[0], numbers) == (0, sorted(set(numbers)))


def test_unread_frames_of_one_host_do_not_reach_the_next(path: str) -> None:
    host = Host(open_port(path))
    host.begin()
    last = host.next_state().sample_index
    time.sleep(0.1)
    host.link.close()
    time.sleep(0.05)
    port = os.open(path, os.O_RDWR | os.O_NOCTTY)  # pyserial would flush by itself
    try:
        received = b""
        while not (frames := FrameSplitter().feed(received)):
            received += os.read(port, 4096)
    finally:
        os.close(port)
    _, first = unpack(frames[0])
    assert isinstance(first, m.State)
    assert first.sample_index > last + 10  # an unread frame would be the next one; the rig may be late


def test_a_pause_of_the_whole_process_is_counted_and_not_made_up_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """The server's clock jumps by half a second, then by an hour; only the first passes in simulated time."""
    jump_ns, monotonic_ns = 0, time.monotonic_ns
    with served_rig(firmware=False) as path:  # it ends before its clock jumps back, which no real one does
        host = Host(open_port(path))
        host.begin()
        before = host.next_state()
        monkeypatch.setattr(time, "monotonic_ns", lambda: monotonic_ns() + jump_ns)
        jump_ns = 500_000_000
        while (after := host.next_state()).missed_ticks < 400:
            pass
        assert after.missed_ticks - before.missed_ticks <= after.sample_index - before.sample_index
        jump_ns = 3_600_000_000_000
        while (later := host.next_state()).missed_ticks < 65_535:
            pass
        assert later.sample_index - after.sample_index < 60_000
        host.disarm()
        host.link.close()


def test_it_ends_after_its_duration_or_by_sigterm_and_removes_its_link(tmp_path: Path) -> None:
    link, announced = tmp_path / "rig", []
    pty.serve(rotary_rig(), announce=announced.append, link_path=link, duration_s=0.05)
    pty.serve(rotary_rig(), announce=lambda _: os.kill(os.getpid(), signal.SIGTERM), link_path=link)
    assert announced == [str(link)]
    assert not link.is_symlink()


@pytest.mark.parametrize(
    ("rate", "firmware", "most"), [(10, False, 4_000), (4_001, False, 4_000), (20_001, True, 20_000)]
)
def test_a_rate_beyond_the_port_is_refused(rate: int, firmware: bool, most: int) -> None:
    with pytest.raises(ConfigError, match=f"rate = {rate} Hz is outside 50 … {most}"):
        pty.serve(rotary_rig(), rate=rate, firmware=firmware, announce=lambda path: None)


def test_a_link_path_that_is_a_file_is_not_touched(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    with pytest.raises(ConfigError, match="exists and is not a symbolic link"):
        pty.serve(rotary_rig(), link_path=path, announce=lambda path: None, duration_s=0.0)
    assert path.read_text() == "mine"
