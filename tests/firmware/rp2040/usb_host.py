"""A minimal USB host on a model of the RP2040's controller with the firmware's stack behind it.

Each method is one packet or one transfer, as a host sends them (USB 2.0, chapters 8 and 9); the toggles are the host's
own. The program has the address and undefined-behaviour sanitizers.
"""

import struct
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from tests.firmware import build

BOARD, CORE = build.FIRMWARE / "boards" / "rp2040", build.FIRMWARE / "core"
SOURCES = [Path(__file__).with_name("usb_controller.c"), *sorted(BOARD.glob("usb*.c"))]
HEAD = struct.Struct("<cB3sxH")
REPLY = struct.Struct("<cBH")
SETUP = struct.Struct("<BBHHH")
PACKET = 64
IN = 0x80


class StallError(Exception):
    """Raised when the device replies STALL."""


def program() -> Path:
    return build.kept_c("usb", SOURCES, [*build.ADDRESS, "-DUSB_ELSEWHERE", f"-I{BOARD}", f"-I{CORE}"])


@dataclass(frozen=True)
class Answer:
    kind: str  # D done, N NAK, S STALL, - no device, Q out of sequence, L too long
    pid: int
    data: bytes


class Host:
    def __init__(self, path: Path) -> None:
        self._process: Any = subprocess.Popen([path], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.toggles: dict[int, int] = {}
        self.address = 0
        self.command("x")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.stdin.close()
        self._process.stdout.close()
        assert self._process.wait() == 0

    def command(self, letter: str, endpoint: int = 0, number: int = 0, data: bytes = b"") -> Answer:
        self._process.stdin.write(
            HEAD.pack(letter.encode(), endpoint, number.to_bytes(3, "little"), len(data)) + data
        )
        self._process.stdin.flush()
        head = self._process.stdout.read(REPLY.size)
        assert head, "the firmware broke a rule of its controller, or of C"
        kind, pid, count = REPLY.unpack(head)
        return Answer(kind.decode(), pid, self._process.stdout.read(count))

    # ------------------------------------------------------------------ packets

    def interrupt(self) -> None:
        self.command("!")

    def frame(self, microseconds: int = 1000) -> None:
        self.command("f", 1, microseconds)
        self.interrupt()

    def later(self, microseconds: int) -> None:
        self.command("f", 0, microseconds)

    def reset(self) -> None:
        self.command("r")
        self.interrupt()
        self.toggles.clear()
        self.address = 0

    def setup(self, kind: int, request: int, value: int, index: int, length: int) -> None:
        self.command("s", data=SETUP.pack(kind, request, value, index, length))
        self.interrupt()

    def fetch(self, endpoint: int, *, lost: bool = False) -> bytes | None:
        """Send one IN packet and check its toggle; return None for NAK. `lost`: our acknowledgement gets lost."""
        answer = self.command("i", endpoint, int(lost))
        if answer.kind == "S":
            raise StallError
        if answer.kind == "N":
            return None
        assert answer.kind == "D", answer
        assert answer.pid == self.toggles.get(IN | endpoint, 0), f"toggle of {endpoint:#x} in"
        if not lost:
            self.toggles[IN | endpoint] = 1 - answer.pid
        self.interrupt()
        return answer.data

    def give(self, endpoint: int, data: bytes) -> bool:
        """Send one OUT packet; return False for NAK."""
        pid = self.toggles.get(endpoint, 0)
        answer = self.command("o", endpoint, pid, data)
        if answer.kind == "S":
            raise StallError
        if answer.kind == "N":
            return False
        assert answer.kind == "D", answer
        self.toggles[endpoint] = 1 - pid
        self.interrupt()
        return True

    # ------------------------------------------------------------------ transfers

    def control_in(self, kind: int, request: int, value: int = 0, index: int = 0, length: int = 255) -> bytes:
        """Request data; return what arrives up to a short packet or the requested length."""
        assert kind & IN
        self.setup(kind, request, value, index, length)
        self.toggles[0], self.toggles[IN] = 1, 1
        data = b""
        while len(data) < length:
            packet = self.fetch(0)
            assert packet is not None, "a request that is neither answered nor refused"
            data += packet
            if len(packet) < PACKET:
                break
        if length == 0:
            assert self.fetch(0) == b""
        else:
            assert len(data) <= length
            self.toggles[0] = 1
            assert self.give(0, b"")
        return data

    def control_out(self, kind: int, request: int, value: int = 0, index: int = 0, data: bytes = b"") -> None:
        assert not kind & IN
        self.setup(kind, request, value, index, len(data))
        self.toggles[0], self.toggles[IN] = 1, 1
        for start in range(0, len(data), PACKET):
            assert self.give(0, data[start : start + PACKET])
        assert self.fetch(0) == b""

    def descriptor(self, kind: int, index: int = 0, length: int = 255) -> bytes:
        return self.control_in(0x80, 6, kind << 8 | index, 0x0409 if kind == 3 else 0, length)

    def text(self, index: int) -> str:
        return self.descriptor(3, index)[2:].decode("utf-16-le")

    def enumerate(self, address: int = 5) -> None:
        self.reset()
        assert len(self.descriptor(1, length=64)) == 18
        self.reset()
        self.control_out(0, 5, address)
        assert self.command("a", number=address).kind == "D"
        self.address = address
        self.configure(1)

    def configure(self, value: int) -> None:
        self.control_out(0, 9, value)
        self.toggles.clear()

    def clear_halt(self, endpoint: int) -> None:
        self.control_out(2, 1, 0, endpoint)
        self.toggles[endpoint] = 0

    # ------------------------------------------------------------------ the firmware's side

    @property
    def is_up(self) -> bool:
        return self.command("u").kind == "D"

    def firmware_writes(self, frame: bytes, offset: int = 0) -> bool:
        return self.command("w", offset, data=frame).kind == "D"

    def firmware_reads(self, capacity: int = 64) -> bytes:
        return self.command("g", number=capacity).data

    def fetch_all(self, endpoint: int = 1) -> list[bytes]:
        packets = []
        self.interrupt()
        while (packet := self.fetch(endpoint)) is not None:
            packets.append(packet)
        return packets
