"""Carry CAN frames as lines of text: ``can send 8001 01000A… BF *5C`` to the drive, ``OK`` and ``rcv …`` back.

`Uart` is the board's own serial port (docs/integration/uart.md of mjbots/moteus at db1a762,
fw/uart_fdcanusb_micro_server.h), `Fdcanusb` the USB adapter (README.md of mjbots/fdcanusb at f18c1d6,
fw/can_manager.cc). `process` uses one of the two. The replies must be those of the makers, word for word.
"""

from sim_backend.drives.bus import Frame
from sim_backend.drives.multiplex import NOP
from sim_backend.drives.socket_can import STANDARD_IDS, pad

LONGEST_LINE = 254  # fw/uart_fdcanusb_micro_server.h; what is longer is thrown away
DATA_BYTES = 64  # largest data of a CAN FD frame
_POLYNOMIAL = 0x97  # docs/integration/uart.md
_SEND = b"can send "
# The texts of `_InvalidLineError` are those of the makers' firmware, word for word.


def _crc_table() -> bytes:
    table = bytearray()
    for byte in range(256):
        for _ in range(8):
            byte = (byte << 1 ^ (_POLYNOMIAL if byte & 0x80 else 0)) & 0xFF  # noqa: PLW2901
        table.append(byte)
    return bytes(table)


_CRC = _crc_table()


def checksum(text: bytes) -> int:
    """Return the CRC-8 of a line of text up to the ``*``, including the space before it."""
    crc = 0
    for byte in text:
        crc = _CRC[crc ^ byte]
    return crc


def seal(text: bytes) -> bytes:
    """Return a line of text with its checksum appended, as the adapter's protocol requires."""
    return b"%b *%02X" % (text, checksum(text + b" "))


class _InvalidLineError(Exception):
    """The line from the host is invalid; the adapter replies ERR with the text of this exception."""


class LineSplitter:
    """A splitter of a byte stream into lines of text."""

    def __init__(self) -> None:
        self._rest = b""

    def split(self, data: bytes) -> list[bytes]:
        """Return the lines that are complete after `data`, each with a line feed; store an incomplete line."""
        *lines, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            self._rest = b""
        return [line + b"\n" for line in lines if line]


class Uart:
    """The serial port on the board of a moteus, which carries CAN frames as lines of text.

    Parameters
    ----------
    prefix
        Setting ``can.prefix`` of the drive; frames with another prefix are ignored.
    """

    def __init__(self, prefix: int = 0) -> None:
        self._prefix = prefix
        self._checked = False

    def splitter(self) -> LineSplitter:
        """Return a new splitter for the bytes that the host sends."""
        return LineSplitter()

    def open(self, unit: bytes) -> tuple[Frame | None, list[bytes]]:
        """Return the CAN frame in a line from the host (None without one), and the port's own replies to it."""
        try:
            frame = self._frame(unit.rstrip())
        except _InvalidLineError as refused:
            return None, self._format_answer(b"ERR " + refused.args[0])
        return frame, self._format_answer(b"OK") if frame is not None else []

    def _frame(self, line: bytes) -> Frame | None:
        line = self._remove_checksum(line)
        if not line.startswith(_SEND):
            raise _InvalidLineError(b"unknown command")
        word, space, rest = line.removeprefix(_SEND).partition(b" ")
        try:
            identifier = int(word, 16)
        except ValueError:
            raise _InvalidLineError(b"invalid hex in id") from None
        if not space:
            raise _InvalidLineError(b"missing data")
        # In silence: on a shared bus a frame with another prefix belongs to another drive.
        if identifier >> 16 & 0x1FFF != self._prefix:
            return None
        data = _parse_hex(rest.partition(b" ")[0])
        if data is None:
            raise _InvalidLineError(b"malformed data")
        return Frame(identifier & 0xFFFF, data[:DATA_BYTES])

    def close(self, frame: Frame) -> list[bytes]:
        """Return a list with the line of text that carries a CAN frame to the host."""
        identifier = self._prefix << 16 | frame.identifier
        return self._format_answer(b"rcv %08x %b" % (identifier, frame.data.hex().encode()))

    def _remove_checksum(self, line: bytes) -> bytes:
        """Return a line without its checksum; raise `_InvalidLineError` if that is wrong, or missing after a first."""
        text, star, digits = line.rpartition(b"*")
        claimed = _parse_hex(digits) if star and len(digits) == 2 else None
        # A checksum is optional until one has come; from then on each command needs one and each answer has one.
        if claimed is None and not self._checked:
            return line
        if claimed is None or checksum(text) != claimed[0]:
            raise _InvalidLineError(b"checksum")
        self._checked = True
        return text.rstrip(b" ")

    def _format_answer(self, text: bytes) -> list[bytes]:
        return [(seal(text) if self._checked else text) + b"\r\n"]


class Fdcanusb:
    """The USB adapter fdcanusb, which is connected to the CAN bus (as after ``can on``)."""

    def splitter(self) -> LineSplitter:
        """Return a new splitter for the bytes that the host sends."""
        return LineSplitter()

    def open(self, unit: bytes) -> tuple[Frame | None, list[bytes]]:
        """Return the CAN frame in a line from the host (None without one), and the adapter's own replies to it."""
        line = unit.rstrip()
        try:
            frame = None if line in {b"can on", b"can off"} else self._frame(line)
        except _InvalidLineError as refused:
            return None, [b"ERR %b\r\n" % refused.args[0]]
        return frame, [b"OK\r\n"]

    @staticmethod
    def _frame(line: bytes) -> Frame:
        if not line.startswith(_SEND):
            raise _InvalidLineError(b"unknown command")
        word, *rest = line.removeprefix(_SEND).split()
        if not rest:
            raise _InvalidLineError(b"insufficient options")
        if set(b"".join(rest[1:])) - set(b"BbFfRr"):
            raise _InvalidLineError(b"unknown flag")
        try:
            identifier = int(word, 16)
        except ValueError:
            identifier = -1
        if not 0 <= identifier < 1 << 29:
            raise _InvalidLineError(b"bad id")
        data = _parse_hex(rest[0])
        if data is None or len(data) > DATA_BYTES:
            raise _InvalidLineError(b"invalid data")
        return Frame(identifier & 0xFFFF, pad(data, NOP))

    def close(self, frame: Frame) -> list[bytes]:
        """Return a list with the line of text that carries a CAN frame to the host."""
        identifier = b"%X" % frame.identifier
        # The adapter prints whole bytes: an even number of hexadecimal digits.
        identifier = identifier.zfill(len(identifier) + len(identifier) % 2)
        kind = b"E" if frame.identifier > STANDARD_IDS else b"e"
        return [
            b"rcv %b %b %b B F r x-1\r\n" % (identifier, pad(frame.data, NOP).hex().upper().encode(), kind)
        ]


def _parse_hex(text: bytes) -> bytes | None:
    try:
        return bytes.fromhex(text.decode("ascii"))
    except ValueError:
        return None
