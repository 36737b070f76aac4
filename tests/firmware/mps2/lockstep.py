"""A simulated plant in lock-step with the firmware, which runs in the emulator or in this computer's build.

Both reply to the same requests (`boards/mps2/lockstep.c` has their bytes), one for each tick of the board.
"""

import os
import re
import select
import struct
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from firmware_protocol.connection import State
from rig.core.model import RigModel
from rig.firmware import _boards as boards
from rig.firmware._board_config import configure
from rig.firmware._build import BuildResult, package_version, sources_hash
from rig.realtime.clock import VirtualClock
from sim_backend.board.hardware import Hardware
from tests.conformance.host import StubLink
from tests.conformance.started import LEASH, started
from tests.firmware import cross
from tests.firmware.build import FIRMWARE, SOURCES, UNDEFINED, compile_c, kept, library

UNITS_PER_SECOND = 16_000_000
REQUEST = struct.Struct("<BBhiQQ?7x64s")
REPLY = struct.Struct("<HhBBHI")
HOST_BYTES = 64
LOOK_S = 0.5  # between two checks that the process runs
HERE = Path(__file__).parent
TRACE = np.dtype([("index", "u4"), ("count", "i4"), ("current", "i2"), ("state", "u1"), ("enabled", "u1")])
MACHINES = {"m0plus": "mps2-an385", "an385": "mps2-an385", "an386": "mps2-an386", "an500": "mps2-an500"}


@dataclass(frozen=True)
class World:
    time: int = 0  # 1/16 µs
    count: int = 0
    edge_time: int = 0
    measured: int = 0
    inputs: int = 0


@dataclass(frozen=True)
class Reply:
    current: int
    state: State
    enabled: bool
    rate: int
    bytes: bytes


Exchange = Callable[[World, bytes, bool], Reply]


def request_of(world: World, data: bytes, ticks: bool) -> bytes:
    assert len(data) <= HOST_BYTES
    return REQUEST.pack(
        len(data), world.inputs, world.measured, world.count, world.time, world.edge_time, ticks, data
    )


class Partner:
    """A process that replies to requests: the image in QEMU, or the same program built for this computer.

    The emulator's virtual time stops while it waits for a request, so every run is alike.
    """

    def __init__(self, command: list[str], directory: Path) -> None:
        for name in ("requests", "replies"):
            os.mkfifo(directory / name)
        # Both ways, so that opening does not wait for the other end.
        self._requests = os.open(directory / "requests", os.O_RDWR)
        self._replies = os.open(directory / "replies", os.O_RDWR)
        self._process = subprocess.Popen([*LEASH, *command], cwd=directory, stdin=subprocess.DEVNULL)

    def __call__(self, world: World, data: bytes, ticks: bool) -> Reply:
        os.write(self._requests, request_of(world, data, ticks))
        received = self._read()
        while len(received) < REPLY.size or len(received) < REPLY.unpack_from(received)[0]:
            received += self._read()
        total, current, state, enabled, _, rate = REPLY.unpack_from(received)
        assert len(received) == total
        return Reply(current, State(state), bool(enabled), rate, received[REPLY.size :])

    def _read(self) -> bytes:
        while not select.select([self._replies], [], [], LOOK_S)[0]:
            assert self._process.poll() is None, f"it ended with {self._process.returncode}"
        return os.read(self._replies, 1 << 16)

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._requests)
        os.close(self._replies)


COUNTED = ("-icount", "shift=5,sleep=off")  # time in instructions


def emulator(board: str, serial: str = "none", time: Sequence[str] = COUNTED) -> list[str]:
    machine = MACHINES[board.partition("-")[2] or "an386"]
    command = [cross.need_qemu(), "-M", machine, "-display", "none", "-monitor", "none", "-serial", serial]
    return [*command, "-semihosting-config", "enable=on,target=native", *time]


@contextmanager
def behind_uart(command: Sequence[object], image: BuildResult) -> Iterator[str]:
    """Run an image in the emulator, with its UART as a pseudo-terminal of this computer; yield the URL."""
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with started(*command, "-kernel", image.elf, text=True, **pipes) as process:
        assert process.stdout is not None
        printed = process.stdout.readline()
        place = re.search(r"/dev/pts/\d+", printed)
        assert place is not None, printed
        yield f"serial://{place[0]}"


def in_emulator(built: BuildResult, directory: Path) -> Partner:
    return Partner([*emulator(built.board), "-kernel", str(built.elf)], directory)


def on_this_computer(model: RigModel, board: str, directory: Path) -> Partner:
    """Start the same program with the same constants, built by this computer's compiler with the core of `library`."""
    core = library()

    def make(output: Path) -> None:
        kind = boards.load(board)
        made = configure(kind, model, {}, package=package_version(), sources=sources_hash(kind))
        (output / "board_config.h").write_text(made.header)
        (output / "board_config.c").write_text(made.source)
        port = {path for path in kind.sources("tests") if path.name not in ("start.c", "semihosting.c")}
        sources = [*sorted(port - {*SOURCES}), output / "board_config.c", HERE / "on_this_computer.c", core]
        include = [f"-I{path}" for path in (output, FIRMWARE / "core", FIRMWARE / "law", kind.directory)]
        compile_c(output / "program", sources, [*include, *UNDEFINED])

    files = (HERE / "on_this_computer.c").read_text()
    made = kept(f"lockstep {board} {model} {cross.sources_of(board)} {files} {core}", make)
    return Partner([str(made / "program")], directory)


class Rig(StubLink):
    """A simulated rig on a `Partner`; also the link by which a host reaches the device."""

    def __init__(self, exchange: Exchange, model: RigModel) -> None:
        self._exchange = exchange
        self.clock = VirtualClock()
        self._world = World()
        self._to_device = b""
        self._to_host: list[bytes] = []
        self.reply = exchange(self._world, b"", False)
        self._rate = self.reply.rate
        self.hardware = Hardware(model, self._rate, seed=0, initial_position=None)
        self._trace: list[tuple[int, int, int, int, int]] = []
        self.sent: list[bytes] = [self.reply.bytes]
        self.inputs = 0

    @property
    def trace(self) -> np.ndarray:
        return np.array(self._trace, TRACE)

    def tick(self) -> None:
        """Run a tick of the board (sample, law, current), then move the plant until the next."""
        for at in range(0, max(1, len(self._to_device)), HOST_BYTES):
            piece = self._to_device[at : at + HOST_BYTES]
            last = at + HOST_BYTES >= len(self._to_device)
            self.reply = self._exchange(self._world, piece, last)
            self._keep(self.reply)
        self._to_device = b""
        self._trace.append(
            (len(self._trace), self._world.count, self.reply.current, self.reply.state, self.reply.enabled)
        )
        self._move()

    def _keep(self, reply: Reply) -> None:
        if reply.bytes:
            self._to_host.append(reply.bytes)
            self.sent.append(reply.bytes)

    def _move(self) -> None:
        if self.reply.rate != self._rate:
            self._rate = self.reply.rate
            self.hardware.set_rate(self._rate)
        self.hardware.advance(self.reply.current)
        time = self._world.time + UNITS_PER_SECOND // self._rate
        age = round(min(self.hardware.edge_age_s * UNITS_PER_SECOND, time))
        self._world = World(time, self.hardware.count, time - age, self.hardware.measured, self.inputs)
        self.clock.sleep_until(time * 125 // 2)

    # ------------------------------------------------------------------ as a link

    def write(self, data: bytes) -> None:
        self._to_device += data

    def read(self, timeout_s: float) -> bytes:
        end_ns = self.clock.now_ns() + round(timeout_s * 1e9)
        while not self._to_host and self.clock.now_ns() < end_ns:
            self.tick()
        sent, self._to_host = b"".join(self._to_host), []
        return sent
