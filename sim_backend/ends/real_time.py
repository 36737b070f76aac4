"""Run the device in Python in real time behind any port: the reference for `board_time`, used without a C compiler.

In each period the plant moves under the active current, the device sends a STATE, and then processes the bytes that
came meanwhile: the reply to STATE k acts from sample k + 1 on. `pty` and `usb` use it.
"""

import threading
import time
from typing import Protocol

from sim_backend.board.device import SimulatedDevice
from sim_backend.board.safety import UNITS_PER_SECOND

CATCH_UP_TICKS = 4  # late ticks that are run at once, each with its STATE
# After a longer pause (a suspended process) the grid restarts: the simulated world stood still too.
LONGEST_PAUSE_S = 1.0
READ_BYTES = 4096

_UNIT_NS = 1e9 / UNITS_PER_SECOND


class DevicePort(Protocol):
    """The device's side of a link. No method blocks beyond its deadline (CLOCK_MONOTONIC, ns)."""

    def read(self, deadline_ns: int) -> bytes:
        """Return bytes from the host; wait for some until the deadline, then return b""."""
        ...

    def write(self, frames: bytes) -> None:
        """Send frames now, or when the host reads; discard them while too many bytes are unread."""
        ...

    def write_if_free(self, frame: bytes) -> None:
        """Send a frame unless older ones still wait; the host sees the loss from the sequence numbers."""
        ...


class RealTime:
    """Loop that runs a device in Python behind a port, tick by tick in real time, until `stop` is set."""

    def __init__(self, device: SimulatedDevice, port: DevicePort, stop: threading.Event) -> None:
        self.device = device
        self._port = port
        self._stop = stop
        self._origin_ns = 0

    def run(self, duration_s: float | None) -> None:
        """Run the device in real time for `duration_s` seconds (None: without end), or until `stop` is set."""
        start_ns = time.monotonic_ns()
        end_ns = start_ns + round(duration_s * 1e9) if duration_s is not None else None
        self._origin_ns = start_ns - self.device.elapsed_ns
        while not self._stop.is_set():
            # Deadlines follow from the device's own clock, so lateness never adds up.
            deadline_ns = self._origin_ns + self.device.next_tick_ns
            if end_ns is not None and deadline_ns > end_ns:
                return
            received, came_at = self._listen(deadline_ns)
            self._miss_late_ticks()
            self._tick()
            if received:
                self._port.write(self.device.receive(received, received_at=came_at))

    def _listen(self, deadline_ns: int) -> tuple[bytes, int]:
        """Wait for the next tick; return the bytes from the host, and the device time of the first one (1/16 µs)."""
        received = b""
        came_at = self.device.time
        while True:
            data = self._port.read(deadline_ns)
            if data and not received:
                late_ns = time.monotonic_ns() - self._origin_ns - self.device.elapsed_ns
                came_at = self.device.time + max(0, round(late_ns / _UNIT_NS))
            received += data
            if time.monotonic_ns() >= deadline_ns or len(received) >= READ_BYTES:
                break
        sleep_until(deadline_ns)
        return received, came_at

    def _miss_late_ticks(self) -> None:
        """Run late ticks without sending a STATE and count them as missed; keep the last four (`CATCH_UP_TICKS`)."""
        device = self.device
        late_ns = time.monotonic_ns() - self._origin_ns - device.next_tick_ns
        if late_ns > LONGEST_PAUSE_S * 1e9:
            self._origin_ns += late_ns
            device.missed_ticks += late_ns * device.rate // 1_000_000_000
            return
        # More late ticks pass without STATE and are counted in `missed_ticks`, which is no fault: this computer was
        # late, and the device works on each tick.
        for _ in range(late_ns * device.rate // 1_000_000_000 - CATCH_UP_TICKS):
            device.miss()

    def _tick(self) -> None:
        started_ns = time.perf_counter_ns()
        state = self.device.tick()
        units = round((time.perf_counter_ns() - started_ns) / _UNIT_NS)
        self.device.worst_execution_time = max(self.device.worst_execution_time, units)
        self._port.write_if_free(state)


def sleep_until(deadline_ns: int) -> None:
    """Sleep until `deadline_ns` (CLOCK_MONOTONIC, ns); return at once if this time has passed."""
    remaining_ns = deadline_ns - time.monotonic_ns()
    if remaining_ns > 0:
        time.sleep(remaining_ns * 1e-9)
