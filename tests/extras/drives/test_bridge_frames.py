"""Lines and frames agree with the manufacturers' documents and libraries."""

import ctypes
import os
import socket
import struct
import subprocess

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rig.core.errors import ConfigError, DeviceNotFoundError, LinkLostError, RigError
from rig.devices.device import DeviceUrl
from rig.extras.drives.bus import AdapterBus, CanBus, CanFrame, open_bus
from rig.extras.drives.library import BRIDGE, Adapter, CanFrameBytes, library
from tests.conformance.bridged import CURRENT, Bridged, armed, push
from tests.conformance.drives import CAN_FRAME, CANFD_FRAME
from tests.firmware import build


def parse_lines(text: bytes, *, checksum: bool = False) -> tuple[list[CanFrame], Adapter]:
    adapter, frame = Adapter(checksum=checksum), CanFrameBytes()
    frames = [
        CanFrame(frame.id, frame.data)
        for byte in text
        if library().fdcanusb_take(ctypes.byref(adapter), byte, ctypes.byref(frame))
    ]
    return frames, adapter


def make_line(frame: CanFrame, *, checksum: bool = False) -> bytes:
    into = ctypes.create_string_buffer(256)
    adapter = Adapter(checksum=checksum)
    count = library().fdcanusb_make(ctypes.byref(adapter), ctypes.byref(frame.as_struct()), into)
    return into.raw[:count]


def test_a_line_as_the_maker_shows_it() -> None:
    """The example is from docs/protocol/can.md, with its flags for CAN FD at the higher rate."""
    data = bytes.fromhex("01000a07206000200150ff140400130d")
    assert make_line(CanFrame(0x8001, data)) == b"can send 8001 01000A07206000200150FF140400130D BF\n"
    (frame,), _ = parse_lines(b"rcv 100 2404000a005000000170ff230d181400 E B F\r\n")
    assert frame == CanFrame(0x100, bytes.fromhex("2404000a005000000170ff230d181400"))


@pytest.mark.parametrize(
    "text",
    [
        b"rcv 100\r\n", b"rcv 100 2\r\n", b"rcv 100 2g\r\n", b"rcv  21\r\n", b"rcv 123456789 21\r\n", b"rcv x 21\r\n",
        b"rc 100 21\r\n", b"rcv 100 " + b"21" * 65 + b"\r\n", b"rcv 100 " + b"2" * 400 + b"\r\n", b"\xff\xfe\r\n",
    ],
)  # fmt: skip
def test_a_malformed_line_is_only_counted(text: bytes) -> None:
    frames, adapter = parse_lines(text)
    assert frames == []
    assert adapter.garbled == 1
    assert parse_lines(text + b"OK\r\nrcv 100 21\r\n")[0] == [CanFrame(0x100, b"\x21")]


def test_replies_of_the_adapter_itself_are_counted() -> None:
    _, adapter = parse_lines(b"OK\r\nERR bad id\r\nOK\r\n")
    assert (adapter.sent, adapter.refused, adapter.garbled) == (2, 1, 0)


@settings(max_examples=25)
@given(
    st.integers(0, 2**29 - 1), st.binary(min_size=1, max_size=64), st.integers(0, 10_000), st.integers(1, 255)
)
@example(0, b"\xbf", 0, 1)  # data that look like the flags
def test_a_line_with_a_checksum_arrives_or_not(identifier: int, data: bytes, place: int, bits: int) -> None:
    sent = (
        make_line(CanFrame(identifier, data), checksum=True).removeprefix(b"can send ").rsplit(b" BF ", 1)[0]
    )
    plain = b"rcv " + sent + b" "
    sealed = plain + b"*%02X\r\n" % _crc(plain)
    assert parse_lines(sealed, checksum=True)[0] == [CanFrame(identifier, data)]
    at = place % (len(sealed) - 2)
    broken = sealed[:at] + bytes((sealed[at] ^ bits,)) + sealed[at + 1 :]
    frames, _ = parse_lines(broken, checksum=True)
    # A letter may change its case in the star.
    assert all(frame == CanFrame(identifier, data) for frame in frames)


def _crc(text: bytes) -> int:
    crc = 0
    for byte in text:
        crc ^= byte
        for _ in range(8):
            crc = crc << 1 ^ (0x97 if crc & 0x80 else 0)
        crc &= 0xFF
    return crc


@settings(max_examples=25)
@given(st.binary(max_size=600), st.booleans())
def test_any_bytes_do_no_harm(data: bytes, checksum: bool) -> None:
    parse_lines(data, checksum=checksum)


# ---------------------------------------------------------------------- the maker's library as the oracle


def test_the_makers_library_reads_a_torque_command_as_it_is_meant() -> None:
    multiplex = pytest.importorskip("moteus.multiplex")
    world, host = armed()
    push(host, 5)
    lines: list[bytes] = []
    world.strike("to drive", lambda sent: lines.append(sent) or sent)
    push(host, 2)
    frame = bytes.fromhex(lines[0].split(b" ")[3].decode())
    written = {
        one.register: one.value
        for one in multiplex.parse_frame(frame)
        if one.type == multiplex.SubframeType.WRITE
    }
    (mode, position, velocity, torque, kp, kd, limit, watchdog, integral) = (
        written[register] for register in (0x000, 0x020, 0x021, 0x022, 0x023, 0x024, 0x025, 0x027, 0x02B)
    )
    assert (mode, velocity, kp, kd, integral) == (10, 0, 0, 0, 0)
    assert position == -128  # of an int8: where it is
    assert torque == pytest.approx(CURRENT * 1e-3 * 0.1 / 2.0)
    assert limit == pytest.approx(0.5)
    assert watchdog == pytest.approx(0.005)
    asked = {one.register for one in multiplex.parse_frame(frame) if one.type == multiplex.SubframeType.READ}
    assert asked == {0x000, 0x001, 0x002, 0x003, 0x00D, 0x00E, 0x00F}


# ---------------------------------------------------------------------- buses


@pytest.mark.parametrize(
    ("place", "error", "words"),
    [
        ("", ConfigError, "no serial port and no CAN interface"),
        ("/dev/no-such-port", DeviceNotFoundError, "there is no port"),
        ("no-such-can", DeviceNotFoundError, "CAN"),
    ],
)
def test_a_bus_that_is_not_there(place: str, error: type[RigError], words: str) -> None:
    with pytest.raises(error, match=words):
        open_bus(DeviceUrl.parse(f"moteus://{place}"))


def test_an_adapter_works_through_a_pseudo_terminal() -> None:
    master, slave = os.openpty()
    try:
        bus = open_bus(DeviceUrl.parse(f"moteus://{os.ttyname(slave)}?checksum=off"))
        assert isinstance(bus, AdapterBus)
        bus.send(CanFrame(0x8001, b"\x11\x00"))
        assert os.read(master, 100) == b"can send 8001 1100 BF\n"
        os.write(master, b"OK\r\nrcv 0100 2100")
        assert bus.receive(0.01) is None
        os.write(master, b"0A\r\n")
        assert bus.receive(1.0) == CanFrame(0x100, b"\x21\x00\x0a")
        bus.close()
    finally:
        os.close(master)
        os.close(slave)


def make_can_pair() -> tuple[CanBus, socket.socket]:
    """Return a bus and its other end: a socket pair that keeps messages separate, as a raw CAN socket does."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    return CanBus("can0", ours), theirs


@settings(max_examples=25)
@given(st.integers(0, 2**29 - 1), st.binary(max_size=64))
def test_a_frame_of_a_can_socket(identifier: int, data: bytes) -> None:
    """The layout is `struct canfd_frame` of linux/can.h: id with flag for 29 bits, length, flags, 64 bytes."""
    bus, end = make_can_pair()
    bus.send(CanFrame(identifier, data))
    packed = end.recv(100)
    extended = 0x80000000 if identifier > 0x7FF else 0
    assert packed == CANFD_FRAME.pack(identifier | extended, len(data), 1, data)
    end.send(packed)
    assert bus.receive(1.0) == CanFrame(identifier, data)
    bus.send(CanFrame(identifier & 0x7FF, data[:8], classic=True, remote=not data))
    remote = 0 if data else 0x40000000
    assert end.recv(100) == CAN_FRAME.pack(identifier & 0x7FF | remote, len(data[:8]), data[:8])
    bus.close()
    end.close()


def test_a_frame_without_data_is_ignored() -> None:
    bus, end = make_can_pair()
    remote, error = 0x40000001, 0x20000040  # CAN_RTR_FLAG; CAN_ERR_FLAG with CAN_ERR_BUSOFF
    for identifier in (remote, error):
        end.send(identifier.to_bytes(4, "little") + bytes(12))
    end.send(b"short")
    end.send((5).to_bytes(4, "little") + bytes((9, 0, 0, 0)) + bytes(8))  # nine bytes in a classic frame
    end.send((5).to_bytes(4, "little") + bytes((1, 0, 0, 0)) + b"\x07" + bytes(7))
    assert bus.receive(1.0) == CanFrame(5, b"\x07")
    end.close()
    with pytest.raises(LinkLostError):
        bus.send(CanFrame(1, b""))
    bus.close()


def test_an_odrive_receives_the_frames_of_its_makers_description() -> None:
    """An independent library decodes each frame of a run, from arming to the end."""
    base = pytest.importorskip("odrive_can").get_dbc()
    sent: list[tuple[str, dict[str, object]]] = []

    def read(message: bytes) -> bytes:
        identifier, size = struct.unpack_from("=IB", message)
        one = base.get_message_by_frame_id(identifier)
        sent.append((one.name, dict(one.decode(message[8 : 8 + size]))))
        return message

    world = Bridged(kind="odrive")
    world.strike("to drive", read)
    _, host = armed(world)
    push(host, 20)
    world._to_drive(world.bridge.stop())
    assert sent[:4] == [
        ("Axis0_Clear_Errors", {"Identify": 0}),
        ("Axis0_Set_Controller_Mode", {"Control_Mode": "TORQUE_CONTROL", "Input_Mode": "PASSTHROUGH"}),
        ("Axis0_Set_Input_Torque", {"Input_Torque": 0.0}),
        ("Axis0_Set_Axis_State", {"Axis_Requested_State": "CLOSED_LOOP_CONTROL"}),
    ]
    torques = [fields["Input_Torque"] for name, fields in sent if name == "Axis0_Set_Input_Torque"]
    assert torques.count(pytest.approx(CURRENT * 1e-3 * 0.05)) > 15
    assert torques[-1] == 0.0
    assert sent[-1] == ("Axis0_Set_Axis_State", {"Axis_Requested_State": "IDLE"})
    names = {name for name, _ in sent}
    assert names == {name for name, _ in sent[:4]}


def test_bus_statistics_are_reported() -> None:
    world = Bridged()
    world.run(0.1)
    facts = world.bridge.facts.as_mapping()
    assert facts["temperature"] == 25
    assert facts["millivolts"] == 24_000
    assert facts["median_us"] == pytest.approx(160, abs=10)  # 80 µs each way


def test_the_c_code_compiles_without_a_warning() -> None:
    sources = [path for path in BRIDGE.sources() if path.parent.name == "bridge"]
    assert len(sources) == 7
    command = [build.compiler(), "-std=c99", "-D_GNU_SOURCE", *build.WARNINGS, "-fsyntax-only"]
    done = subprocess.run([*command, *map(str, sources)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
