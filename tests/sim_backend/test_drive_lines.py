"""Links between a host and a simulated drive: text lines, checksums, scripted faults. Time is virtual."""

import itertools
import os
import struct

import pytest

from rig.core.errors import ConfigError, DeviceNotFoundError
from rig.devices.fault_script import Direction, FaultKind, FrameFault
from sim_backend.drives.bus import Frame
from sim_backend.drives.can_simple import CanSimpleCommand, Error
from sim_backend.drives.faults import DriveEvent, DriveScript
from sim_backend.drives.fdcanusb import Fdcanusb, LineSplitter, Uart, checksum, seal
from sim_backend.drives.outlets import DriveSockets, UnpluggableTerminal
from sim_backend.drives.process import serve
from sim_backend.drives.socket_can import ERROR, EXTENDED, REMOTE, SocketCan, from_wire, to_wire
from tests.conformance.drives import CAN_FRAME, CANFD_FRAME, MS, Moteus, Odrive, Wire, drive_rig, served
from tests.conformance.rigs import linear_rig

FRAME = Frame(0x8001, bytes.fromhex("01000a"))
STILL = {"servo.timeout_mode": "0"}
TORQUE = bytes.fromhex("01000a0c0620 0000c07f 00000000 cdcc4c3d 00000000 00000000 0000c07f 0d2b00000000 1100")
# mode 10; from 0x020: NaN, 0, 0.05 N·m, kp 0, kd 0, NaN; ilimit scale 0; reads the mode


def bitwise(data: bytes) -> int:
    """Return the CRC-8 with polynomial 0x97, most significant bit first, computed by its definition."""
    crc = 0
    for bit in itertools.chain.from_iterable(f"{byte:08b}" for byte in data):
        crc = (crc << 1 & 0xFF) ^ (0x97 if (crc >> 7) ^ int(bit) else 0)
    return crc


def test_the_checksum_is_the_one_of_its_polynomial() -> None:
    for text in (b"", b"OK ", b"can send 8001 01000a07206000200150ff140400130d ", bytes(range(256))):
        assert checksum(text) == bitwise(text)


def test_after_the_first_checksum_each_line_needs_one_and_each_answer_has_one() -> None:
    uart = Uart()
    assert uart.open(b"can send 8001 01000a\n") == (FRAME, [b"OK\r\n"])
    assert uart.open(seal(b"can send 8001 01000a bF") + b"\n") == (FRAME, [seal(b"OK") + b"\r\n"])
    assert uart.open(b"can send 8001 01000a\n") == (None, [seal(b"ERR checksum") + b"\r\n"])
    assert uart.open(b"can send 8001 01000b *00\n")[0] is None
    assert uart.close(Frame(0x0100, b"\x21\x00\x0a")) == [seal(b"rcv 00000100 21000a") + b"\r\n"]


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (b"hello", b"ERR unknown command\r\n"),
        (b"can send 80x1 00", b"ERR invalid hex in id\r\n"),
        (b"can send 8001", b"ERR missing data\r\n"),
        (b"can send 8001 0g", b"ERR malformed data\r\n"),
    ],
)
def test_invalid_line_is_answered_with_the_reason(line: bytes, answer: bytes) -> None:
    assert Uart().open(line + b"\n") == (None, [answer])


def test_frames_of_another_prefix_are_passed_over_in_silence() -> None:
    assert Uart(prefix=0x0123).open(b"can send 8001 00\n") == (None, [])
    assert Uart(prefix=0x0123).open(b"can send 1238001 00\n")[0] == Frame(0x8001, b"\0")


def test_the_usb_adapter_knows_flags_and_no_checksums_and_fills_up() -> None:
    adapter = Fdcanusb()
    frame, reply = adapter.open(b"can send 8001 " + bytes(9).hex().encode() + b" BF\n")
    assert (frame, reply) == (Frame(0x8001, bytes(9) + b"\x50" * 3), [b"OK\r\n"])
    assert adapter.open(b"can send 8001 00 *1F\n") == (None, [b"ERR unknown flag\r\n"])
    assert adapter.open(b"can on\n") == (None, [b"OK\r\n"])
    assert adapter.close(Frame(0x100, b"\1" * 3)) == [b"rcv 0100 010101 e B F r x-1\r\n"]


def test_lines_end_in_any_way_and_too_long_ones_are_thrown_away() -> None:
    lines = LineSplitter()
    assert lines.split(b"a\r\nb\n\rc") == [b"a\n", b"b\n"]
    assert lines.split(b"d\n") == [b"cd\n"]
    assert lines.split(b"x" * 300) == []
    assert lines.split(b"OK\n") == [b"OK\n"]


def test_frames_are_those_of_socketcan() -> None:
    can = SocketCan()
    sent = Frame(0x2E, b"\1\2\3\4")
    (unit,) = can.close(sent)
    message = CAN_FRAME.pack(0x2E, 4, sent.data)
    assert (to_wire(unit), from_wire(message)) == (message, unit)
    assert can.open(unit) == (sent, [])
    asked = from_wire(CAN_FRAME.pack(REMOTE | 0x09, 8, b""))
    assert can.open(asked) == (Frame(0x09, b"", remote=True), [])
    report = from_wire(CAN_FRAME.pack(ERROR | 0x04, 8, b""))  # from this computer's CAN controller
    assert can.open(report) == (None, [])
    assert can.splitter().split(unit + asked) == [unit, asked]
    assert from_wire(b"no frame") == b""


def test_frames_of_can_fd_are_padded_and_dropped_by_classic_can() -> None:
    can = SocketCan(fd=True, padding=0x50)
    (unit,) = can.close(Frame(0x0100, bytes(9)))
    message = CANFD_FRAME.pack(0x0100, 12, 0x05, bytes(9) + b"\x50" * 3)
    assert (to_wire(unit), from_wire(message)) == (message, unit)
    # An old kernel does not set the flag of CAN FD.
    query = from_wire(CANFD_FRAME.pack(EXTENDED | 0x8001, 2, 0x01, b"\x11\0"))
    assert can.open(query) == (Frame(0x8001, b"\x11\0", extended=True), [])
    assert SocketCan().open(query) == (None, [])


def test_moteus_replies_on_can_fd_and_a_host_off_the_bus_gets_an_error_frame() -> None:
    can = SocketCan(fd=True, padding=0x50)
    ask = [(at * MS, can.close(Frame(0x8001, b"\x11\0", extended=True))[0]) for at in range(1, 6)]
    wire = served(Moteus().drive, can, ask, DriveScript.of(["host-bus-off frame=3"]), 0.01)
    *answers, last = [struct.unpack_from("=IB", frame) for _, frame in wire.sent]
    assert answers == [(0x0100, 3)] * 3
    assert last == (0x20000040, 8)


# ---------------------------------------------------------------------- faults on command


def commands(frames: int) -> list[tuple[int, bytes]]:
    """Return commands of 0.05 N·m, one a millisecond."""
    line = seal(b"can send 8001 " + TORQUE.hex().encode()) + b"\n"
    return [((1 + at) * MS, line) for at in range(frames)]


def run(fault: str, frames: int = 60, duration_s: float = 0.3) -> tuple[Wire, Moteus]:
    """Command a simulated moteus for `frames` ms, then stop and run beyond its watchdog."""
    drive = Moteus(settings=STILL)
    return served(drive.drive, Uart(), commands(frames), DriveScript.of([fault]), duration_s), drive


def test_a_script_is_read_from_words() -> None:
    script = DriveScript.of(
        ["drop to=device frame=3", "corrupt tick=7 byte=2 bit=1", "fault value=33 tick=20"]
    )
    assert script.frames == (
        FrameFault(kind=FaultKind.DROP, direction=Direction.TO_DEVICE, frame=3),
        FrameFault(kind=FaultKind.CORRUPT, direction=Direction.TO_HOST, tick=7, byte=2, bit=1),
    )
    assert script.events == (DriveEvent(name="fault", value=33.0, tick=20),)


@pytest.mark.parametrize(
    "words", ["drop", "drop frame=1 tick=2", "drop to=moon frame=1", "melt frame=1", "drop frame=x"]
)
def test_invalid_fault_is_refused(words: str) -> None:
    with pytest.raises(ConfigError):
        DriveScript.of([words])


def test_without_faults_each_line_is_answered_and_the_torque_ends_by_the_watchdog() -> None:
    drive = Moteus(settings=STILL)
    wire = served(drive.drive, Uart(), commands(60), DriveScript(), 0.12)
    assert len(wire.sent) == 60
    assert drive.command == pytest.approx(0.05)
    wire = served(drive.drive, Uart(), [], DriveScript(), 0.3)
    assert (drive.command, drive.read(0)) == (0.0, 11)


KINDS = ["drop", "duplicate", "reorder", "delay ticks=5", "silence", "unplug"]
STRUCK = (0, 1, 2, 11, 17, 18, 19)  # frames: the first, one in the middle, the last


@pytest.mark.parametrize("kind", [*KINDS, "corrupt byte=9 bit=1", "truncate byte=7"])
@pytest.mark.parametrize("to", ["device", "host"])
def test_fault_on_any_frame_of_a_moteus_ends_without_torque(kind: str, to: str) -> None:
    for frame in STRUCK:
        wire, drive = run(f"{kind} to={to} frame={frame}", frames=20, duration_s=0.2)
        assert drive.command == 0.0
        assert drive.read(0) in {0, 11}
        assert wire.pulled == (kind == "unplug")


@pytest.mark.parametrize(
    ("fault", "mode"),
    [
        ("fault value=33 tick=30", 1),
        ("expire tick=30", 11),
        ("reboot tick=30", 11),
        ("voltage value=3 tick=30", 1),
    ],
)
def test_event_of_the_drive_ends_without_torque(fault: str, mode: int) -> None:
    wire, drive = run(fault)
    assert drive.command == 0.0
    assert drive.read(0) == mode
    assert len(wire.sent) >= 60


def test_a_stale_reply_is_the_one_before() -> None:
    drive = Moteus(settings=STILL)
    ask = [(at * MS, b"can send 8001 1d01\n") for at in range(10, 50, 10)]
    drive.start(timeout=float("nan"))
    drive.torque(0.05, timeout=float("nan"))
    wire = served(drive.drive, Uart(), ask, DriveScript.of(["stale frame=2"]), 0.06)
    replies = [line.split(b"rcv ")[1] for _, line in wire.sent]
    assert replies[2] == replies[1]
    assert len(set(replies)) == 3


def test_a_delayed_reply_holds_up_those_behind_it() -> None:
    wire, _ = run("delay to=host frame=20 ticks=7")
    times = [at for at, _ in wire.sent]
    assert times == sorted(times)
    assert max(later - sooner for sooner, later in itertools.pairwise(times)) >= 7 * MS


def test_the_simulated_world_stands_still_while_its_process_is_kept_from_running() -> None:
    drive = Moteus(settings=STILL)
    wire = served(drive.drive, Uart(), commands(60), DriveScript(), 0.07)
    assert drive.read(0) == 10
    wire.now += 500 * MS
    late = served(drive.drive, Uart(), [(0, commands(1)[0][1])], DriveScript(), 0.001)
    assert late.sent
    assert drive.read(0) == 10


def test_on_a_can_bus_a_damaged_frame_is_a_lost_one() -> None:
    script = DriveScript.of(["corrupt frame=1", "truncate frame=2 to=device", "delay frame=3"])
    assert [fault.kind for fault in script.on_a_can_bus().frames] == [
        FaultKind.DROP,
        FaultKind.DROP,
        FaultKind.DELAY,
    ]
    drive = Odrive()
    can = SocketCan()
    ask = [
        (at * MS, can.close(Frame(CanSimpleCommand.GET_VERSION, b"", remote=True))[0]) for at in range(1, 6)
    ]
    wire = served(drive.drive, can, ask, script.on_a_can_bus(), 0.008)
    frames = can.splitter().split(b"".join(frame for _, frame in wire.sent))
    versions = [
        frame for frame in frames if struct.unpack_from("=I", frame) == (CanSimpleCommand.GET_VERSION,)
    ]
    assert len(versions) == 4


ARMED = {
    "axis0.controller.config.control_mode": "1",
    "axis0.config.enable_watchdog": "1",
    "axis0.config.watchdog_timeout": "0.02",
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("to", ["device", "host"])
def test_fault_on_any_frame_of_an_odrive_ends_without_torque(kind: str, to: str) -> None:
    can = SocketCan()
    torque = can.close(Frame(CanSimpleCommand.SET_INPUT_TORQUE, struct.pack("<f", 0.05)))[0]
    arm = can.close(Frame(CanSimpleCommand.SET_AXIS_STATE, struct.pack("<I", 8)))[0]
    sent = [(MS, torque), (2 * MS, arm), *((at * MS, torque) for at in range(3, 20))]
    for frame in STRUCK:
        drive = Odrive(settings=ARMED)
        script = DriveScript.of([f"{kind} to={to} frame={frame}"]).on_a_can_bus()
        served(drive.drive, can, sent, script, 0.1)
        assert (drive.drive.motor.torque, drive.state) == (0.0, 1)
        assert drive.errors[1] in {Error.WATCHDOG_TIMER_EXPIRED, 0}  # 0: it was never armed


def test_a_pulled_terminal_ends_the_hosts_file_and_takes_nothing_any_more() -> None:
    with UnpluggableTerminal() as terminal:
        host = os.open(terminal.place, os.O_RDWR | os.O_NOCTTY)
        terminal.unplug()
        assert os.read(host, 10) == b""
        os.close(host)
        terminal.write(b"lost")
        assert terminal.read(0) == b""


def test_unsupported_drive_is_refused_with_the_reason() -> None:
    with pytest.raises(ConfigError, match="linear"):
        serve("moteus", linear_rig())
    with pytest.raises(ConfigError, match="bus"):
        serve("odrive", drive_rig())
    with pytest.raises(ConfigError, match="adapter"):
        serve("moteus", drive_rig(), adapter="slcan")
    with pytest.raises(ConfigError, match="melt"):
        serve("moteus", drive_rig(), faults=["melt frame=1"])
    with pytest.raises(ConfigError, match="bus-off"):
        serve("moteus", drive_rig(), faults=["bus-off frame=1"])
    with pytest.raises(DeviceNotFoundError, match="nocan0"):
        DriveSockets("nocan0")
    with pytest.raises(ConfigError, match="cannot be created"):
        DriveSockets("/no/such/place")
