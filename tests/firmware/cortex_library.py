"""The firmware built for a Cortex-M and simulated: its host port with the functions of the shared library.

`CortexLibrary` has the interface of `sim_backend.board.firmware_library.load`; addresses of this computer represent its
only device. Each `host_tick` stores its cost.
"""

import ctypes
import pickle
import struct
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from rig.firmware import _cortex as cortex
from rig.firmware._cortex import RAM, CortexCore, Image
from rig.firmware._toolchain import find_compiler
from sim_backend.board.firmware_library import HostStatus
from tests.firmware import cross
from tests.firmware.build import FIRMWARE, SOURCES, content, kept

ENTRIES = (
    "device_tick", "host_poll", "host_bytes", "host_setup", "host_narrow", "host_start", "host_receive", "host_take",
    "host_set_world", "host_status",
)  # fmt: skip
HOST, SETUP, STATUS, BYTES, DICTIONARY = (RAM + at for at in (0x0, 0x6_0000, 0x6_0100, 0x6_0400, 0x6_4000))
MOST_BYTES, MOST_DICTIONARY = 0x3C00, 0x7000


CORES = {name: core for name, core in cortex.CORES.items() if core.cycles_known}


def link(core: CortexCore, sources: Sequence[Path], entries: Sequence[str], *more: str) -> Image:
    cross.need_compiler()
    options = [*(f"-I{FIRMWARE / part}" for part in ("core", "law")), *more]

    def make(output: Path) -> None:
        image = cortex.build(core, output, sources, entries, *options)
        (output / "image").write_bytes(pickle.dumps(image))

    read = content({*FIRMWARE.rglob("*.[ch]"), Path(cortex.__file__), *sources})
    key = f"{core} {find_compiler()} {sources} {entries} {options} {read}"
    image: Image = pickle.loads((kept(key, make) / "image").read_bytes())
    return image


class Simulator(cortex.Simulator):
    def __post_init__(self) -> None:
        pytest.importorskip("unicorn", reason="unicorn is not installed (pip install unicorn==2.1.4)")
        super().__post_init__()


def build(core: CortexCore, *options: str) -> Image:
    image = link(core, SOURCES, ENTRIES, f"-I{FIRMWARE / 'host'}", *options)
    held = [name for name in image.sizes if image.symbols[name] >= RAM]
    assert not held, f"globals: {held}"
    return image


class CortexLibrary:
    def __init__(self, image: Image) -> None:
        self.simulator = Simulator(image)
        assert self.host_bytes() <= SETUP - HOST
        self.instructions: list[int] = []  # of each tick
        self.cycles: list[int] = []
        self.polls: list[int] = []  # cycles of the longest device_poll behind each tick
        self.profile: list[Counter[int]] | None = None  # cycles of each block in each tick, if wanted

    def host_bytes(self) -> int:
        return self.simulator.call("host_bytes")

    def host_setup(self, address: int, setup: Any) -> None:
        given = setup._obj
        dictionary = ctypes.string_at(given.dictionary, given.dictionary_bytes)
        assert len(dictionary) <= MOST_DICTIONARY
        self._write(DICTIONARY, dictionary)
        words = (given.dictionary_bytes, given.rate_initial, given.encoder_sign, given.over_current)
        head = struct.pack("<I4xQIIiI", DICTIONARY, given.dictionary_hash, *words)
        self._write(SETUP, head + bytes(given.mechanics) + bytes(given.current_sensor))
        self.simulator.call("host_setup", HOST, SETUP)

    def host_narrow(self, address: int, parameter: int, minimum: int, maximum: int) -> None:
        self.simulator.call("host_narrow", HOST, parameter, minimum, maximum)

    def host_start(self, address: int) -> None:
        self.simulator.call("host_start", HOST)

    def host_set_world(
        self, address: int, time: int, count: int, edge_time: int, measured: int, inputs: int
    ) -> None:
        low, high = time & 0xFFFF_FFFF, time >> 32
        rest = struct.pack("<i4xQiI", count, edge_time, measured, inputs)  # what goes by the stack
        self.simulator.call("host_set_world", HOST, 0, low, high, stack=rest)

    def host_tick(self, address: int) -> None:
        if self.profile is not None:
            self.simulator.profile = Counter()
            self.profile.append(self.simulator.profile)
        self.simulator.call("device_tick", HOST)  # struct host begins with the device
        self.simulator.profile = None
        self.instructions.append(self.simulator.instructions)
        self.cycles.append(self.simulator.cycles)
        self.polls.append(self._poll())

    def host_receive(self, address: int, data: bytes, count: int) -> None:
        self._write(BYTES, data)
        self.simulator.call("host_receive", HOST, BYTES, count)

    def _poll(self) -> int:
        """Poll until nothing is left to send; return the largest number of cycles of a poll."""
        longest = 0
        for _ in range(6):
            self.simulator.call("host_poll", HOST, BYTES, 0)
            longest = max(longest, self.simulator.cycles)
        return longest

    def host_take(self, address: int, into: Any, capacity: int) -> int:
        count = self.simulator.call("host_take", HOST, BYTES, min(capacity, MOST_BYTES))
        ctypes.memmove(into, bytes(self.simulator.uc.mem_read(BYTES, count)), count)
        return count

    def host_status(self, address: int, status: Any) -> None:
        self.simulator.call("host_status", HOST, STATUS)
        size = ctypes.sizeof(HostStatus)
        ctypes.memmove(status, bytes(self.simulator.uc.mem_read(STATUS, size)), size)

    def _write(self, address: int, data: bytes) -> None:
        self.simulator.uc.mem_write(address, data)
