"""A serial port as a link, on pseudo-terminals: open errors, line settings, unplugging, a full line."""

import errno
import fcntl
import os
import struct
import termios
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from rig.core.errors import ConfigError, DeviceNotFoundError, LinkLostError
from rig.devices import _threaded_serial as threaded_serial
from rig.devices import _tty as tty_settings
from rig.devices import descriptor, port_facts
from rig.devices import serial as ports
from rig.devices._serial_options import DEFAULT_BAUD
from rig.devices._serial_options import capacity as capacity_of
from rig.devices.device import DeviceUrl
from rig.devices.serial import SerialLink, open_link
from rig.doctor._ports import serial_port

SLACK_S = 5.0  # of a loaded machine: these tests say "bounded", not "quick"
IFLAG, OFLAG, CFLAG, LFLAG, CC = 0, 1, 2, 3, 6


def opened(path: str, **options: object) -> SerialLink:
    query = "&".join(f"{name}={value}" for name, value in options.items())
    return open_link(DeviceUrl.parse(f"serial://{path}" + (f"?{query}" if query else "")))


@pytest.fixture
def link(line: Any) -> Iterator[Any]:
    made = opened(line.path)
    yield made
    made.close()


@pytest.fixture(params=[open_link, threaded_serial.open_link], ids=["descriptor", "threads"])
def serial_link(line: Any, request: pytest.FixtureRequest) -> Iterator[Any]:
    """Yield a serial link for Linux, or the one for other systems."""
    made = request.param(DeviceUrl.parse(f"serial://{line.path}"))
    yield made
    made.close()


def test_bytes_pass_both_ways_unchanged(line: Any, serial_link: Any) -> None:
    every = bytes(range(256))
    serial_link.write(every)
    assert os.read(line.device, 1000) == every
    os.write(line.device, every)
    got = b""
    while len(got) < len(every):
        got += serial_link.read(SLACK_S)
    assert got == every


# ---------------------------------------------------------------------- opening


def test_a_missing_port_is_named_with_the_ports_that_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(port_facts, "available_ports", lambda: [("/dev/ttyACM3", "board")])
    with pytest.raises(DeviceNotFoundError, match="there is no port /dev/nothere") as caught:
        opened("/dev/nothere")
    assert "/dev/ttyACM3" in caught.value.remedy
    assert caught.value.exit_code == 3


def test_a_file_that_is_no_serial_port_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    for path in ("/dev/null", str(tmp_path / "file"), str(tmp_path)):
        with pytest.raises(DeviceNotFoundError, match=path):
            opened(path)


def test_a_busy_port_is_refused_and_opens_when_it_is_free_again(line: Any) -> None:
    first = opened(line.path)
    with pytest.raises(DeviceNotFoundError, match="in use by another program") as caught:
        opened(line.path)
    assert "fuser" in caught.value.remedy
    first.close()
    opened(line.path).close()


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (serial.SerialException(errno.EACCES, "could not open port"), "no permission"),
        (serial.SerialException(errno.EBUSY, "could not open port"), "in use"),
        (serial.SerialException(errno.EIO, "could not open port"), "cannot open"),
        (serial.SerialException("Could not configure port: (25, 'ioctl')"), "cannot open"),
        (termios.error(errno.ENOTTY, "Inappropriate ioctl"), "is not a serial port"),
        (ValueError("Failed to set custom baud rate"), "is not a serial port"),
        (OSError(errno.ENXIO, "no such device"), "is not a serial port"),
    ],
)
def test_each_error_of_the_system_is_typed(error: Any, message: str, line: Any, monkeypatch: Any) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(DeviceNotFoundError, match=message):
        opened(line.path)


RATES = ("fast", "", "-9600", "299", "20000001", "1e6", "²", "9600.0")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("baud", rate) for rate in RATES),
        *(("dtr", word) for word in ("yes", "", "1", "ON")),
        ("parity", "even"),
    ],
)
def test_an_invalid_option_is_refused(name: str, value: str, line: Any) -> None:
    with pytest.raises(ConfigError, match=name):
        opened(line.path, **{name: value})
    with pytest.raises(ConfigError, match="no serial port"):
        opened("")


def vanish(descriptor: int) -> None:
    raise termios.error(errno.EIO, "Input/output error")


@pytest.mark.parametrize(
    ("configure", "words"),
    [(vanish, "/dev/pts/"), (lambda descriptor: None, "VMIN")],
    ids=["vanishes", "keeps no settings"],
)
def test_a_port_that_fails_while_opening_leaves_no_descriptor(
    configure: Any, words: str, line: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = set(os.listdir("/proc/self/fd"))
    with monkeypatch.context() as patched:
        patched.setattr(ports.tty, "configure", configure)
        with pytest.raises(DeviceNotFoundError, match=words):
            opened(line.path)
    assert set(os.listdir("/proc/self/fd")) == before
    opened(line.path).close()


# ---------------------------------------------------------------------- settings of the line


def test_the_line_is_raw_blocks_for_a_byte_and_does_not_hang_up_when_closed(line: Any) -> None:
    """With VMIN 1 an empty read means hang-up; without HUPCL closing keeps DTR, so no board is reset."""
    default = opened(line.path)
    assert termios.tcgetattr(default.port().handle)[4] == getattr(termios, f"B{DEFAULT_BAUD}")
    default.close()
    link = opened(line.path, baud=115200)
    assert link.bytes_per_second is None
    settings = termios.tcgetattr(link.port().handle)
    assert settings[CC][termios.VMIN] in (1, b"\x01")
    assert settings[CC][termios.VTIME] in (0, b"\x00")
    assert not settings[CFLAG] & termios.HUPCL
    assert not settings[IFLAG] & (termios.IXON | termios.IXOFF | termios.ICRNL | termios.ISTRIP)
    assert not settings[OFLAG] & termios.OPOST
    assert not settings[LFLAG] & (termios.ICANON | termios.ECHO | termios.ISIG)
    assert settings[4] == settings[5] == termios.B115200
    link.close()
    after = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
    assert not termios.tcgetattr(after)[CFLAG] & termios.HUPCL
    os.close(after)


def test_bytes_from_before_opening_are_discarded(line: Any) -> None:
    keep = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
    os.write(line.device, b"old news")
    link = opened(line.path)
    assert link.read(0.02) == b""
    link.close()
    os.close(keep)


@pytest.mark.parametrize(
    ("name", "baud", "capacity"),
    [
        ("ttyUSB0", 921_600, 92_160.0),  # start and stop bit: ten bits a byte
        ("ttyS0", 115_200, 11_520.0),
        ("ttyAMA0", 57_600, 5_760.0),
        ("ttyACM0", 9_600, None),  # USB CDC: the rate means nothing
        ("ttyACM12", 921_600, None),
    ],
)
def test_the_rate_limits_a_uart_and_nothing_else(name: str, baud: int, capacity: Any, tmp_path: Path) -> None:
    assert capacity_of(f"/dev/{name}", baud) == capacity
    alias = tmp_path / "by-id"
    alias.symlink_to(f"/dev/{name}")
    assert capacity_of(str(alias), baud) == capacity, "the port counts, not its alias"


def test_a_listed_port_opens_by_its_url_whatever_its_name(line: Any, tmp_path: Path) -> None:
    for name in ("usb-ACME_Rig#2", "usb-ACME_Rig?x=1", os.fsdecode(b"usb \xff\n")):
        (tmp_path / name).symlink_to(line.path)
        found = open_link(DeviceUrl.parse(serial_port(str(tmp_path / name))[0].url))
        assert found.facts.device == line.path
        found.close()


# ---------------------------------------------------------------------- modem lines, low latency, exclusion


def test_a_pseudo_terminal_has_no_modem_lines_and_is_not_exclusive(link: Any) -> None:
    assert link.facts.low_latency is None
    assert link.facts.dtr is None
    assert link.facts.exclusive is False, "it would stay so after a kill -9: no program could open the port"
    assert link.messages == []


def test_closing_a_port_that_would_drop_dtr_leaves_it(line: Any) -> None:
    """Many boards reset when DTR drops."""
    with open(
        line.path, "rb", buffering=0, opener=lambda path, _: os.open(path, os.O_RDWR | os.O_NOCTTY)
    ) as before:
        attributes = termios.tcgetattr(before)
        attributes[CFLAG] |= termios.HUPCL
        termios.tcsetattr(before, termios.TCSANOW, attributes)
        assert tty_settings.hangs_up(before.fileno())
        link = opened(line.path)
        assert link.facts.hangs_up is False
        assert not tty_settings.hangs_up(before.fileno())
        link.close()


@pytest.fixture
def real_port(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Replace a pseudo-terminal's ioctls by those of a port with modem lines and a driver."""
    monkeypatch.setattr(ports, "is_pseudo", lambda device: False)
    return ModemLine(monkeypatch)


class ModemLine:
    """The ioctls of a line with DTR, RTS and a driver that may keep the low-latency flag."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, keeps_flag: bool = True) -> None:
        self.lines = termios.TIOCM_DTR | termios.TIOCM_RTS
        self.flags = 0
        self.keeps_flag = keeps_flag
        self.asked = []
        self._real = fcntl.ioctl
        monkeypatch.setattr(tty_settings.fcntl, "ioctl", self.ioctl)

    def ioctl(self, descriptor: Any, request: Any, argument: int = 0, *more: Any) -> Any:
        if request in (termios.TIOCMBIS, termios.TIOCMBIC):
            (bits,) = struct.unpack("i", argument)
            self.asked.append((request, bits))
            self.lines = self.lines | bits if request == termios.TIOCMBIS else self.lines & ~bits
        elif request == termios.TIOCMGET:
            argument[:] = struct.pack("i", self.lines)
        elif request == termios.TIOCGSERIAL:
            argument[4] = self.flags
        elif request == termios.TIOCSSERIAL:
            if self.keeps_flag is None:
                raise PermissionError(errno.EPERM, "Operation not permitted")
            self.flags = argument[4] if self.keeps_flag else self.flags
        else:
            return self._real(descriptor, request, argument, *more)
        return 0


def test_dtr_is_asserted_and_never_moves_again(line: Any, real_port: Any) -> None:
    link = opened(line.path)
    assert link.facts.dtr is True
    link.write(b"x")
    link.read(0.0)
    link.close()
    assert all(request == termios.TIOCMBIS for request, _ in real_port.asked)
    assert real_port.lines & termios.TIOCM_DTR


def test_dtr_off_takes_dtr_and_rts_back_in_one_step(line: Any, real_port: Any) -> None:
    """A board whose reset depends on both lines is held in reset if only one changes."""
    link = opened(line.path, dtr="off")
    assert link.facts.dtr is False
    assert link.messages == []
    assert real_port.asked[-1] == (termios.TIOCMBIC, termios.TIOCM_DTR | termios.TIOCM_RTS)
    assert real_port.lines == 0
    link.close()


@pytest.mark.parametrize("keeps_flag", [True, False, None])  # None: the driver raises an error
def test_low_latency_is_set_and_read_back(keeps_flag: bool | None, line: Any, real_port: Any) -> None:
    real_port.keeps_flag = keeps_flag
    link = opened(line.path)
    assert link.facts.low_latency is bool(keeps_flag)
    assert real_port.flags == (tty_settings.ASYNC_LOW_LATENCY if keeps_flag else 0)
    link.close()


def test_a_real_port_is_refused_to_others_while_it_is_open(line: Any, real_port: Any) -> None:
    link = opened(line.path)
    assert link.facts.exclusive is True
    link.close()
    after = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
    assert tty_settings.is_exclusive(after) is False, "and free when it is closed"
    os.close(after)


def test_a_setting_that_the_port_refuses_is_a_message_with_its_remedy(
    line: Any, monkeypatch: pytest.MonkeyPatch, real_port: Any
) -> None:
    monkeypatch.setattr(tty_settings, "set_exclusive", lambda descriptor, wanted: False)
    monkeypatch.setattr(tty_settings, "is_exclusive", lambda descriptor: False)
    monkeypatch.setattr(tty_settings, "set_dtr_rts", lambda descriptor, asserted: not asserted)
    monkeypatch.setattr(port_facts, "is_pseudo", lambda device: False)
    link = opened(line.path)
    exclusive, dtr = link.messages
    assert f"fuser -v {line.path}" in exclusive
    assert "DTR is off" in dtr
    link.close()


# ---------------------------------------------------------------------- full lines


def test_a_write_without_a_reader_is_bounded(serial_link: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(descriptor, "WRITE_TIMEOUT_S", 0.05)
    before = time.monotonic()
    with pytest.raises(LinkLostError, match="accepts no more bytes"):
        serial_link.write(b"x" * 4_000_000)
    if isinstance(serial_link, SerialLink):
        assert time.monotonic() - before >= 0.05


def test_a_line_that_is_read_late_takes_everything(line: Any, link: Any) -> None:
    sent = os.urandom(40_000)
    got = bytearray()

    def device() -> None:
        while len(got) < len(sent):
            got.extend(os.read(line.device, 1000))

    reader = threading.Thread(target=device)
    reader.start()
    link.write(sent)
    reader.join(SLACK_S)
    assert bytes(got) == sent


# ---------------------------------------------------------------------- a pulled plug


def test_a_pulled_plug_is_a_lost_link_in_both_directions(line: Any, serial_link: Any) -> None:
    line.unplug()
    with pytest.raises(LinkLostError, match=f"{line.path} is gone") as caught:
        serial_link.read(SLACK_S)
    assert "cable" in caught.value.remedy
    with pytest.raises(LinkLostError):
        serial_link.write(b"x")


def test_a_plug_pulled_while_reading_is_noticed_at_once(line: Any, link: Any) -> None:
    pulling = threading.Timer(0.05, line.unplug)
    pulling.start()
    with pytest.raises(LinkLostError):  # at the timeout it would return no bytes
        link.read(60.0)
    pulling.join()
