"""The simulated rig as a process of its own: a pseudo-terminal that any serial program opens, in real time.

The device here is the one of `device`; this file gives it a clock and a port. In each period: the plant moves under
the current in force, STATE goes out, and then the bytes that came meanwhile are handed to the device. So the answer
to STATE k acts from sample k + 1 on: one tick of delay at least, as behind any real port.

Time keeps its grid: deadlines follow from the device's own clock, so lateness never adds up. A process that wakes a
few ticks late runs them at once; what is beyond that passes without STATE and is counted in `missed_ticks`; after a
pause longer than `LONGEST_PAUSE_S` (a suspended process) the grid starts anew, because the simulated world stood
still too.

It mirrors a USB serial device: it stays when a host goes, even by kill -9, and its watchdog knows of that only by
the silence. After the hang-up of the line it writes nothing, for nobody would read it; what a host does not read in
time is thrown away, newest first, whole frames only.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

from rig.errors import ConfigError
from rig.model import RigModel
from sim_backend.device import SimulatedDevice
from sim_backend.safety import UNITS_PER_SECOND

POSITION_RATE_DEFAULT = 1_000
POSITION_RATE_MAXIMUM = 4_000  # what an ordinary kernel wakes a Python process for, with room for the frames
CATCH_UP_TICKS = 4  # late ticks that are run at once, each with its STATE
LONGEST_PAUSE_S = 1.0
READ_BYTES = 4096
PENDING_BYTES = 8192  # answers that the host has not read yet

_UNIT_NS = 1e9 / UNITS_PER_SECOND


def serve(
    model: RigModel,
    *,
    rate: int = POSITION_RATE_DEFAULT,
    seed: int = 0,
    name: str | None = None,
    announce: Callable[[str], None] = print,
    stop_event: threading.Event | None = None,
    link_path: str | Path | None = None,
    duration_s: float | None = None,
) -> None:
    """Run a simulated rig behind a pseudo-terminal until it is told to stop.

    Parameters
    ----------
    model
        The physics.
    rate
        Ticks a second (Hz) that the device advertises and runs until it is configured.
    seed
        Of the sensor noise.
    name
        What the device calls itself; the model's name unless given.
    announce
        Called once with the path of the port, when a host can open it.
    stop_event
        Ends the run when it is set.
    link_path
        A symbolic link to make to the port, for a name that stays; removed at the end.
    duration_s
        Ends the run after this time (s).

    Notes
    -----
    Called in the main thread it also ends, cleanly, on SIGINT (Ctrl-C) and SIGTERM.

    Raises
    ------
    ConfigError
        A rate that the port cannot carry, or `link_path` exists and is no symbolic link.
    """
    if not 50 <= rate <= POSITION_RATE_MAXIMUM:
        raise ConfigError(
            f"rate = {rate} Hz is outside 50 … {POSITION_RATE_MAXIMUM}",
            remedy="a pseudo-terminal in Python carries no more; run faster in virtual time (sim://)",
        )
    device = SimulatedDevice(
        model,
        name=name,
        position_rate_default=rate,
        position_rate_maximum=POSITION_RATE_MAXIMUM,
        seed=seed,
        keep_truth=False,  # it would grow for ever, and nobody could read it
    )
    stop = stop_event or threading.Event()
    with _Port() as port, _linked(link_path, port.path), _signals(stop):
        announce(str(link_path) if link_path is not None else port.path)
        _Server(device, port, stop).run(duration_s)


class _Server:
    """The clock of a device, and the mover of its bytes."""

    def __init__(self, device: SimulatedDevice, port: _Port, stop: threading.Event) -> None:
        self._device = device
        self._port = port
        self._stop = stop
        self._origin_ns = 0

    def run(self, duration_s: float | None) -> None:
        """Tick until told to stop."""
        start_ns = time.monotonic_ns()
        end_ns = start_ns + round(duration_s * 1e9) if duration_s is not None else None
        self._origin_ns = start_ns - self._device.elapsed_ns
        while not self._stop.is_set():
            deadline_ns = self._origin_ns + self._device.next_tick_ns
            if end_ns is not None and deadline_ns > end_ns:
                return
            received, came_at = self._listen(deadline_ns)
            self._keep_up()
            self._tick()
            if received:
                self._port.write(self._device.receive(received, received_at=came_at))

    def _listen(self, deadline_ns: int) -> tuple[bytes, int]:
        """Wait for the tick; return what the host sent meanwhile, and when it began to come (device time)."""
        received = b""
        came_at = self._device.time
        while True:
            data = self._port.read(deadline_ns)
            if data and not received:
                late_ns = time.monotonic_ns() - self._origin_ns - self._device.elapsed_ns
                came_at = self._device.time + max(0, round(late_ns / _UNIT_NS))
            received += data
            if time.monotonic_ns() >= deadline_ns or len(received) >= READ_BYTES:
                break
        _sleep_until(deadline_ns)
        return received, came_at

    def _keep_up(self) -> None:
        """Let the ticks pass that cannot be told any more, and count them."""
        device = self._device
        late_ns = time.monotonic_ns() - self._origin_ns - device.next_tick_ns
        if late_ns > LONGEST_PAUSE_S * 1e9:
            self._origin_ns += late_ns
            device.missed_ticks += late_ns * device.rate // 1_000_000_000
            return
        for _ in range(late_ns * device.rate // 1_000_000_000 - CATCH_UP_TICKS):
            device.miss()

    def _tick(self) -> None:
        started_ns = time.perf_counter_ns()
        state = self._device.tick()
        units = round((time.perf_counter_ns() - started_ns) / _UNIT_NS)
        self._device.worst_execution_time = max(self._device.worst_execution_time, units)
        self._port.write_if_free(state)


def _sleep_until(deadline_ns: int) -> None:
    remaining_ns = deadline_ns - time.monotonic_ns()
    if remaining_ns > 0:
        time.sleep(remaining_ns * 1e-9)


class _Port:
    """The master side of a pseudo-terminal in raw mode. No call blocks beyond its deadline."""

    def __init__(self) -> None:
        self._master, slave = os.openpty()
        self.path = os.ttyname(slave)
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        os.close(slave)  # from now on a hang-up says that no host has it open
        self._pending = b""
        self._hung_up = False

    def __enter__(self) -> _Port:
        return self

    def __exit__(self, *error: object) -> None:
        os.close(self._master)

    def read(self, deadline_ns: int) -> bytes:
        """Return what the host sent, waiting for it until the deadline; without a host, nothing, at the deadline."""
        if self._hung_up:  # the descriptor polls as readable then: sleep instead, and look once
            _sleep_until(deadline_ns)
        remaining_s = max(0, deadline_ns - time.monotonic_ns()) * 1e-9
        readable, _, _ = select.select([self._master], [], [], remaining_s)
        if not readable:
            self._hung_up = False
            return b""
        try:
            data = os.read(self._master, READ_BYTES)
        except OSError:
            self._hang_up()
            return b""
        self._hung_up = False
        return data

    def write(self, frames: bytes) -> None:
        """Send answers, now or as soon as the host reads; a host that leaves kilobytes unread loses them."""
        if self._hung_up or len(self._pending) + len(frames) > PENDING_BYTES:
            return
        self._pending += frames
        with contextlib.suppress(OSError):
            self._pending = self._pending[os.write(self._master, self._pending) :]

    def write_if_free(self, frame: bytes) -> None:
        """Send a frame that is worth nothing later, unless older ones still wait; its sequence shows the loss."""
        if self._pending:
            self.write(b"")
        if not self._pending:
            self.write(frame)

    def _hang_up(self) -> None:
        """When a host goes, what it has not read goes too: the next one begins with an empty line."""
        if not self._hung_up:
            self._hung_up = True
            self._pending = b""
            with contextlib.suppress(OSError, termios.error):
                slave = os.open(
                    self.path, os.O_RDWR | os.O_NOCTTY
                )  # its line discipline keeps 4 KiB for ever
                termios.tcflush(slave, termios.TCIFLUSH)
                os.close(slave)


@contextlib.contextmanager
def _linked(link_path: str | Path | None, target: str) -> Iterator[None]:
    """Keep a symbolic link to the port while it is open."""
    if link_path is None:
        yield
        return
    link = Path(link_path)
    if link.exists() and not link.is_symlink():
        raise ConfigError(f"{link} exists and is no symbolic link", remedy="choose another path")
    try:
        link.unlink(missing_ok=True)
        link.symlink_to(target)
    except OSError as error:
        raise ConfigError(f"{link} cannot be made: {error}", remedy="choose another path") from error
    try:
        yield
    finally:
        if link.is_symlink() and os.readlink(link) == target:
            link.unlink()


@contextlib.contextmanager
def _signals(stop: threading.Event) -> Iterator[None]:
    """Turn SIGINT and SIGTERM into `stop` while this lasts; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: stop.set()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
