"""The port to this computer as a board in simulated time, correct or with one defect, and the link to it."""

import ctypes
import re
from collections.abc import Callable
from pathlib import Path

from rig.realtime.clock import VirtualClock
from tests.conformance.host import StubLink
from tests.firmware.build import FIRMWARE, UNDEFINED, kept_c

HERE = Path(__file__).parent
SIMULATED = FIRMWARE / "port_check" / "simulated"
WRONG = HERE / "wrong_ports.c"
SLICE_US = 500
Run = Callable[[int, bytes], bytes]  # let time pass (µs) with bytes for the board; the bytes that came
MOST_BYTES = 1 << 18


def wrong_ports() -> list[str]:
    """Return the names of the defective ports: ``duty`` or ``duty__how``."""
    return re.findall(r"^void wrong_(\w+)\(", WRONG.read_text(), re.MULTILINE)


def board_with(firmware: ctypes.CDLL) -> ctypes.CDLL:
    """Return the board as a library of this computer, linked to the firmware's; undefined behaviour aborts."""
    core = Path(firmware._name)
    include = [f"-I{FIRMWARE / part}" for part in ("core", "law")] + [f"-I{SIMULATED}"]
    sources = [*sorted(SIMULATED.glob("*.c")), WRONG, core]
    flags = ["-fPIC", "-shared", f"-Wl,-rpath,{core.parent}", *include, *UNDEFINED]
    library = ctypes.CDLL(str(kept_c("board.so", sources, flags)))
    library.simulated_board_bytes.restype = library.simulated_board_run.restype = ctypes.c_size_t
    library.simulated_board_start.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    library.simulated_board_run.argtypes = [
        ctypes.c_void_p, ctypes.c_uint32, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_void_p, ctypes.c_size_t,
    ]  # fmt: skip
    return library


def powered_up(library: ctypes.CDLL, spoilt: str = "") -> Run:
    """Power up a board in this process, with a port that the function `spoilt` of wrong_ports.c changes."""
    memory = ctypes.create_string_buffer(library.simulated_board_bytes())
    into = ctypes.create_string_buffer(MOST_BYTES)
    spoil = ctypes.cast(getattr(library, spoilt), ctypes.c_void_p) if spoilt else None
    library.simulated_board_start(memory, spoil)

    def run(us: int, data: bytes) -> bytes:
        count = library.simulated_board_run(memory, us, data, len(data), into, MOST_BYTES)
        return ctypes.string_at(into, count)

    return run


class SimulatedPort(StubLink):
    def __init__(self, run: Run, slice_us: int = SLICE_US) -> None:
        self.clock = VirtualClock()
        self._run, self._slice_us = run, slice_us
        self._to_board = b""

    def write(self, data: bytes) -> None:
        self._to_board += data

    def read(self, timeout_s: float) -> bytes:
        """Advance time until bytes arrive or the timeout has passed."""
        ends_ns = self.clock.now_ns() + round(timeout_s * 1e9)
        while (left_ns := ends_ns - self.clock.now_ns()) > 0:
            us = min(self._slice_us, -(-left_ns // 1000))
            given, self._to_board = self._to_board, b""
            came = self._run(us, given)
            self.clock.sleep_until(self.clock.now_ns() + us * 1000)
            if came:
                return came
        return b""
