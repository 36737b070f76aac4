"""The RP2040's USB stack on a model of its controller, packet by packet."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.doctor._udev import RIGS
from tests.firmware.rp2040.usb_host import IN, PACKET, SETUP, Host, StallError, program

RIG, PORT, NOTES = 1, 2, 3
DEVICE, CONFIGURATION, STRING, OBJECT_STORE = 1, 2, 3, 15
RING = 32768
QUIET = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
FRAMES = st.binary(min_size=1, max_size=252).map(lambda data: bytes(byte or 1 for byte in data) + b"\0")


@pytest.fixture(scope="module")
def stack() -> Path:
    return program()


@pytest.fixture
def bare(stack: Path) -> Iterator[Host]:
    with Host(stack) as host:
        yield host


@pytest.fixture
def host(bare: Host) -> Host:
    bare.enumerate()
    return bare


def frames_of(data: bytes) -> list[bytes]:
    """Split bytes into frames, as a receiver does, without empty ones."""
    return [part + b"\0" for part in data.split(b"\0") if part]


def pairs(data: bytes) -> Iterator[bytes]:
    while data:
        assert 2 <= data[0] <= len(data)
        yield data[: data[0]]
        data = data[data[0] :]


# ---------------------------------------------------------------------- descriptors of the device


def test_a_host_finds_what_rig_looks_for(host: Host) -> None:
    device = host.descriptor(DEVICE)
    (ids,) = RIGS  # those of the rules that rig doctor prints
    assert struct.unpack_from("<HH", device, 8) == ids
    whole = host.descriptor(CONFIGURATION, length=4096)
    assert struct.unpack_from("<H", whole, 2)[0] == len(whole)
    head, *others = pairs(whole)
    interfaces = [part for part in others if part[1] == 4]
    assert head[4] == len(interfaces) == 3
    at = others.index(interfaces[0])
    assert interfaces[0][5] == 0xFF
    assert [part[2] for part in others[at + 1 : at + 3]] == [IN | RIG, RIG]
    assert all(part[3] == 2 and part[4] == PACKET for part in others[at + 1 : at + 3])
    # the serial port: an association of a control interface with a data interface
    association = others[at + 3]
    assert association[1:5] == bytes([11, 1, 2, 2])
    assert [part[5] for part in interfaces[1:]] == [2, 10]
    endpoints = [part[2] for part in others if part[1] == 5]
    assert len(endpoints) == len(set(endpoints)) == 5


def test_strings_and_the_serial_number(host: Host) -> None:
    assert host.descriptor(STRING, 0) == b"\x04\x03\x09\x04"
    device = host.descriptor(DEVICE)
    assert host.text(device[14]) == "haptic-rig"
    assert host.text(device[16]) == "0123456789ABCDEF"
    named = {part[-1] for part in pairs(host.descriptor(CONFIGURATION)) if part[1] == 4 and part[-1]}
    assert all(host.text(index) for index in named)
    with pytest.raises(StallError):
        host.descriptor(STRING, 99)


def test_descriptor_makes_windows_use_its_own_driver(host: Host) -> None:
    store = host.descriptor(OBJECT_STORE)
    assert struct.unpack_from("<HB", store, 2) == (len(store), 2)
    platform = list(pairs(store))[2]
    assert platform[4:20] == bytes.fromhex("DF60DDD88945C74C9CD2659D9E648A9F")
    _, length, request, _ = struct.unpack("<IHBB", platform[20:])
    descriptor = host.control_in(0xC0, request, 0, 7, 4096)
    assert len(descriptor) == length
    # the set, its one configuration, the function of the vendor interface, nested and of the lengths that they state
    assert struct.unpack_from("<HHIH", descriptor) == (10, 0, 0x06030000, length)
    assert struct.unpack_from("<HHBBH", descriptor, 10) == (8, 1, 0, 0, length - 10)
    assert struct.unpack_from("<HHBBH", descriptor, 18) == (8, 2, 0, 0, length - 18)
    assert descriptor[26:46] == struct.pack("<HH8s8x", 20, 3, b"WINUSB")
    size, kind, strings, name_bytes = struct.unpack_from("<HHHH", descriptor, 46)
    assert (size, kind, strings) == (len(descriptor) - 46, 4, 7)
    name = descriptor[54 : 54 + name_bytes].decode("utf-16-le")
    (value_bytes,) = struct.unpack_from("<H", descriptor, 54 + name_bytes)
    value = descriptor[56 + name_bytes :].decode("utf-16-le")
    assert (name, len(value) * 2) == ("DeviceInterfaceGUIDs\0", value_bytes)
    assert value[0] + value[37:] == "{}\0\0"


def test_as_much_as_is_asked_for_and_no_more(host: Host) -> None:
    """No empty packet follows a reply of whole packets that has the requested length."""
    whole = host.descriptor(CONFIGURATION, length=4096)
    for length in (1, 8, 9, 18, 63, 64, 65, 107, 128, 255, 4096):
        assert host.descriptor(CONFIGURATION, length=length) == whole[:length]
    for length in (PACKET, 2 * PACKET):
        assert len(host.control_in(0xC0, 0x20, 0, 7, length)) == length


# ---------------------------------------------------------------------- standard requests


def test_the_address_holds_from_the_end_of_its_request_on_and_not_if_that_is_given_up(bare: Host) -> None:
    bare.reset()
    bare.setup(0, 5, 9, 0, 0)
    assert bare.command("a", number=0).kind == "D"
    bare.toggles[IN] = 1
    assert bare.fetch(0) == b""
    assert bare.command("a", number=9).kind == "D"
    bare.reset()
    assert bare.command("a", number=0).kind == "D"
    bare.setup(0, 5, 9, 0, 0)
    assert len(bare.descriptor(DEVICE)) == 18
    assert bare.command("a", number=0).kind == "D"


def test_configuration_on_and_off(host: Host) -> None:
    assert host.is_up
    assert host.control_in(0x80, 8, length=1) == b"\1"
    host.configure(0)
    assert not host.is_up
    assert host.control_in(0x80, 8, length=1) == b"\0"
    assert host.command("i", RIG).kind == "-"
    assert not host.firmware_writes(b"lost\0")
    with pytest.raises(StallError):
        host.control_out(0, 9, 2)
    host.configure(1)
    assert host.give(RIG, b"back")
    assert host.firmware_reads() == b"back"


@pytest.mark.parametrize("endpoint", [RIG, IN | RIG, PORT, IN | PORT, IN | NOTES])
def test_a_halt_lasts_until_it_is_cleared(host: Host, endpoint: int) -> None:
    host.control_out(2, 3, 0, endpoint)
    assert host.control_in(0x82, 0, index=endpoint, length=2) == b"\1\0"
    for _ in range(2):
        with pytest.raises(StallError):
            host.fetch(endpoint & 15) if endpoint & IN else host.give(endpoint, b"x")
    host.clear_halt(endpoint)
    assert host.control_in(0x82, 0, index=endpoint, length=2) == b"\0\0"
    if not endpoint & IN:
        assert host.give(endpoint, b"well again")
        assert host.firmware_reads().strip(b"\0") == b"well again"


@pytest.mark.parametrize("sent", [0, 1, 2, 3])
def test_clearing_a_halt_starts_both_toggles_anew(host: Host, sent: int) -> None:
    """The toggles restart for either parity and with packets armed, as when `rig` opens the device."""
    for number in range(sent):
        assert host.give(RIG, bytes([number]))
        assert host.firmware_writes(bytes([number + 1, 0]))
        host.interrupt()
        assert host.fetch(RIG) is not None
    host.firmware_reads()
    assert host.firmware_writes(b"stale\0")
    host.interrupt()
    host.clear_halt(IN | RIG)
    host.clear_halt(RIG)
    assert host.fetch(RIG) is None, "what waited is of a session that is over"
    assert host.firmware_writes(b"fresh\0")
    assert frames_of(b"".join(host.fetch_all())) == [b"fresh\0"]
    assert host.give(RIG, b"new")
    assert host.firmware_reads() == b"new"


def test_choosing_the_only_alternate_setting_starts_its_toggles_anew(host: Host) -> None:
    assert host.give(RIG, b"1")
    assert host.firmware_writes(b"1\0")
    assert host.fetch_all()
    host.control_out(1, 11, 0, 0)
    host.toggles[RIG] = host.toggles[IN | RIG] = 0
    assert host.give(RIG, b"2")
    assert host.firmware_writes(b"2\0")
    assert frames_of(b"".join(host.fetch_all())) == [b"2\0"]
    with pytest.raises(StallError):
        host.control_out(1, 11, 1, 0)


REFUSED = {
    "remote wake-up": (0x00, 3, 1, 0, 0),
    "a test mode": (0x00, 3, 2, 0x100, 0),
    "a descriptor written": (0x00, 7, 0x100, 0, 18),
    "a device qualifier, which full speed has not": (0x80, 6, 0x600, 0, 10),
    "frames of an endpoint in step": (0x82, 12, 0, IN | RIG, 2),
    "an address of eight bits": (0x00, 5, 0x80, 0, 0),
    "a break on the line": (0x21, 0x23, 0, 1, 0),
    "a class request to the vendor interface": (0xA1, 0x21, 0, 0, 7),
    "another vendor request": (0xC0, 0x21, 0, 7, 8),
    "a line coding of six bytes": (0x21, 0x20, 0, 1, 6),
}


def test_unknown_request_is_stalled_and_the_next_one_is_answered(host: Host) -> None:
    for request in REFUSED.values():
        host.setup(*request)
        host.toggles[0] = host.toggles[IN] = 1
        with pytest.raises(StallError):
            host.fetch(0)
        with pytest.raises(StallError):
            host.give(0, b"")
        assert len(host.descriptor(DEVICE)) == 18


def test_the_serial_port_keeps_its_line_coding(host: Host) -> None:
    coding = struct.pack("<IBBB", 3_000_000, 0, 0, 8)
    host.control_out(0x21, 0x20, 0, 1, coding)
    assert host.control_in(0xA1, 0x21, 0, 1, 7) == coding
    host.control_out(0x21, 0x22, 3, 1)


@QUIET
@given(
    st.lists(
        st.tuples(
            st.one_of(st.sampled_from([0, 0x80, 1, 0x81, 2, 0x82, 0x21, 0xA1, 0xC0]), st.integers(0, 255)),
            st.one_of(st.integers(0, 12), st.integers(0, 255)),
            st.one_of(st.sampled_from([0, 1, 0x100, 0x200, 0x300, 0x301, 0xF00]), st.integers(0, 65535)),
            st.one_of(st.sampled_from([0, 1, 2, 7, 0x81, 0x409]), st.integers(0, 65535)),
            st.one_of(st.sampled_from([0, 1, 2, 7, 18, 64, 255]), st.integers(0, 65535)),
        ),
        max_size=20,
    ),
    st.lists(st.integers(0, 3), min_size=1, max_size=8),
)
def test_any_requests_in_any_order_given_up_anywhere(stack: Path, requests: Any, patience: Any) -> None:
    """Each request is answered or refused, none blocks the next, and the device still enumerates and transfers."""
    with Host(stack) as host:
        for number, request in enumerate(requests):
            host.command("s", data=SETUP.pack(*request))
            host.interrupt()
            answers = set()
            for _ in range(patience[number % len(patience)]):
                into, out = host.command("i", 0), host.command("o", 0, 1, b"")
                answers |= {into.kind, out.kind}
                host.interrupt()
            assert answers <= {"D", "N", "S", "Q"}
        host.enumerate()
        assert host.give(RIG, b"alive")
        assert host.firmware_reads() == b"alive"


# ---------------------------------------------------------------------- bytes


@QUIET
@given(st.data())
def test_bytes_arrive_whole_in_order_and_with_their_toggles(stack: Path, data: st.DataObject) -> None:
    with Host(stack) as host:
        host.enumerate()
        sent: list[bytes] = []
        got = b""
        given_bytes, taken = b"", b""
        for _ in range(data.draw(st.integers(5, 60))):
            action = data.draw(st.sampled_from("wwwffogpl"))
            if action == "w":
                frame = data.draw(FRAMES)
                assert host.firmware_writes(frame, data.draw(st.integers(0, 3)))
                sent.append(frame)
                if data.draw(st.booleans()):
                    host.interrupt()
            elif action == "f":
                got += host.fetch(RIG) or b""
            elif action == "l":
                host.fetch(RIG, lost=True)
            elif action == "o":
                packet = data.draw(st.binary(max_size=PACKET))
                if host.give(RIG, packet):
                    given_bytes += packet
            elif action == "g":
                taken += host.firmware_reads(data.draw(st.integers(1, 64)))
                host.interrupt()
            else:
                frame = data.draw(FRAMES)
                host.command("p", number=data.draw(st.integers(1, 80)), data=frame)
                host.frame()
                if host.command("q").kind == "D":
                    sent.append(frame)
        got += b"".join(host.fetch_all())
        while chunk := host.firmware_reads():
            taken += chunk
            host.interrupt()
        assert frames_of(got) == sent
        assert taken == given_bytes


def test_whole_packets_end_with_an_empty_one_and_two_wait_in_the_controller(host: Host) -> None:
    for count in (60, 64, 128, 63, 61):
        frame = bytes([1] * (count - 1)) + b"\0"
        assert host.firmware_writes(frame)
        packets = host.fetch_all()
        assert len(packets[-1]) < PACKET
        assert frames_of(b"".join(packets)) == [frame]
    assert host.firmware_writes(bytes([1] * 251) + b"\0")  # while the processor is busy elsewhere
    host.interrupt()
    assert [host.command("i", RIG).kind for _ in range(3)] == ["D", "D", "N"]


def test_a_host_that_does_not_read_costs_whole_frames(host: Host) -> None:
    frame = bytes([7] * 251) + b"\0"
    taken = 0
    while host.firmware_writes(frame):
        taken += 1
        host.interrupt()
        assert taken < 1000
    assert 0 <= RING + 2 * PACKET - taken * len(frame) < len(frame)
    assert not host.firmware_writes(frame)
    assert frames_of(b"".join(host.fetch_all())) == [frame] * taken
    assert host.firmware_writes(frame)


def test_a_device_that_does_not_read_says_nak_and_loses_nothing(host: Host) -> None:
    sent = b""
    while host.give(RIG, packet := bytes([len(sent) % 251 + 1]) * PACKET):
        sent += packet
        assert len(sent) < 4096
    taken = b""
    while chunk := host.firmware_reads(50):
        taken += chunk
        host.interrupt()
    assert taken == sent
    assert host.give(RIG, b"more")
    assert host.firmware_reads() == b"more"


def test_nothing_is_handed_over_late_in_a_frame(host: Host) -> None:
    """Erratum RP2040-E15: no new packet late in a frame; earlier ones remain."""
    host.frame()
    host.later(850)
    assert host.firmware_writes(b"late\0")
    host.interrupt()
    assert host.fetch(RIG) is None
    host.frame(150)
    assert frames_of(b"".join(host.fetch_all())) == [b"late\0"]
    host.later(799)
    assert host.firmware_writes(b"early\0")
    assert frames_of(b"".join(host.fetch_all())) == [b"early\0"]
    host.later(5000)  # no frame for long: no frame could end
    assert host.firmware_writes(b"alone\0")
    assert frames_of(b"".join(host.fetch_all())) == [b"alone\0"]


# ---------------------------------------------------------------------- the two pipes


def test_pipe_that_sent_last_is_the_link(host: Host) -> None:
    host.later(2_000_000)
    assert host.give(PORT, b"\x05port")
    assert host.firmware_writes(b"to port\0")
    assert frames_of(b"".join(host.fetch_all(PORT))) == [b"to port\0"]
    assert host.fetch(RIG) is None
    assert host.give(RIG, b"\x04rig")
    assert host.firmware_reads() == b"\0\x05port\0\x04rig", "each begins behind a delimiter"
    assert host.firmware_writes(b"to rig\0")
    assert frames_of(b"".join(host.fetch_all(RIG))) == [b"to rig\0"]


def test_a_probe_of_serial_ports_does_not_take_the_link_from_a_session(host: Host) -> None:
    host.later(2_000_000)
    assert host.give(RIG, b"command")
    host.firmware_reads()
    host.later(900_000)
    assert host.give(PORT, b"AT\r\n")
    assert host.firmware_reads() == b""
    assert host.firmware_writes(b"still here\0")
    assert frames_of(b"".join(host.fetch_all(RIG))) == [b"still here\0"]
    host.later(200_000)
    assert host.give(PORT, b"AT\r\n")
    assert host.firmware_reads() == b"\0AT\r\n"


def test_neither_pipe_takes_the_link_of_an_armed_device(host: Host) -> None:
    for mine, other in ((PORT, RIG), (RIG, PORT)):
        host.later(2_000_000)
        assert host.give(mine, b"armed")
        host.firmware_reads()
        host.command("h", number=1)
        host.later(2_000_000)
        assert host.give(other, b"another")
        assert host.firmware_reads() == b""
        assert host.firmware_writes(b"still here\0")
        assert frames_of(b"".join(host.fetch_all(mine))) == [b"still here\0"]
        host.command("h", number=0)
        assert host.give(other, b"another")
        assert host.firmware_reads() == b"\0another"


def test_a_frame_of_which_half_has_left_is_ended(host: Host) -> None:
    assert host.firmware_writes(bytes([9] * 200) + b"\0")
    host.interrupt()
    first = host.fetch(RIG)
    assert first is not None
    assert len(first) == PACKET
    assert first.lstrip(b"\0") == bytes([9] * len(first.lstrip(b"\0")))
    host.clear_halt(IN | RIG)
    assert host.firmware_writes(b"whole\0")
    assert frames_of(b"".join(host.fetch_all())) == [b"whole\0"]


# ---------------------------------------------------------------------- the cable


@pytest.mark.parametrize("restart", ["r", "x"], ids=["of the bus", "of the firmware"])
def test_a_restart_forgets_all(host: Host, restart: str) -> None:
    assert host.firmware_writes(b"old\0")
    host.interrupt()
    host.give(RIG, b"\x07old")
    host.command(restart)
    host.interrupt()
    assert not host.is_up
    assert not host.firmware_writes(b"dropped\0")
    assert host.command("i", RIG).kind == "-"
    host.enumerate()
    assert host.fetch(RIG) is None
    assert host.firmware_writes(b"new\0")
    assert frames_of(b"".join(host.fetch_all())) == [b"new\0"]
    assert host.give(RIG, b"new")


def test_a_silent_bus_takes_no_frames_and_keeps_no_old_ones(host: Host) -> None:
    host.frame()
    for _ in range(20):
        host.firmware_writes(b"before\0")
    host.command("z", number=1)
    host.interrupt()
    assert not host.is_up
    assert not host.firmware_writes(b"dropped\0")
    host.command("z", number=0)
    host.interrupt()
    host.frame()
    assert host.is_up
    assert host.firmware_writes(b"awake\0")
    assert frames_of(b"".join(host.fetch_all()))[-1] == b"awake\0"
    # and a second time
    host.command("z", number=1)
    host.interrupt()
    assert not host.is_up
