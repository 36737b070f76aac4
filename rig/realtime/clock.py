"""Clocks for Python and for the compiled loop: the system's monotonic clock, and a virtual clock for simulations.

Devices and their ports use them. This file must not read the time of day, which can be set back.
"""

import time
from typing import Any, Protocol

import numpy as np

from rig.realtime.system import monotonic_now, monotonic_sleep, virtual_now, virtual_sleep


class Clock(Protocol):
    """Interface of a clock that Python and the compiled loop read; all times are nanoseconds from an arbitrary origin.

    `virtual` is True if the clock's time advances only by `sleep_until` and by its owner, not with real time.
    """

    virtual: bool

    def now_ns(self) -> int:
        """Return the present time of this clock (ns from an arbitrary origin)."""
        ...

    def sleep_until(self, deadline_ns: int) -> None:
        """Sleep until this clock's time is `deadline_ns` (ns) or somewhat later."""
        ...

    @property
    def handle(self) -> int:
        """Return the number that compiled code passes as first argument to `now_plug` and `sleep_plug`."""
        ...

    @property
    def now_plug(self) -> Any:
        """Return the compiled function by which the loop reads this clock: ``now(handle)`` returns a time (ns)."""
        ...

    @property
    def sleep_plug(self) -> Any:
        """Return the compiled function by which the loop sleeps: ``sleep(handle, deadline_ns)``."""
        ...


class MonotonicClock:
    """The system's monotonic clock, which is never set back: CLOCK_MONOTONIC on Linux, else `time.perf_counter`."""

    virtual = False
    handle = 0

    def now_ns(self) -> int:
        """Return the present time of the system's monotonic clock (ns)."""
        # On Linux CLOCK_MONOTONIC. `time.monotonic` of Windows has steps of 16 ms before Python 3.13.
        return time.perf_counter_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        """Sleep until the system's monotonic clock shows the absolute time `deadline_ns` (ns) or somewhat later."""
        remaining = deadline_ns - time.perf_counter_ns()
        if remaining > 0:
            time.sleep(remaining * 1e-9)

    @property
    def now_plug(self) -> Any:
        """Return the compiled function that reads the monotonic clock by clock_gettime."""
        return monotonic_now

    @property
    def sleep_plug(self) -> Any:
        """Return the compiled function that sleeps until an absolute time by clock_nanosleep."""
        return monotonic_sleep


class VirtualClock:
    """A simulated clock: its time changes only by `sleep_until`, which jumps to the deadline at once."""

    virtual = True

    def __init__(self, start_ns: int = 0) -> None:
        self._time = np.array([start_ns], dtype=np.int64)

    def now_ns(self) -> int:
        """Return the present virtual time (ns)."""
        return int(self._time[0])

    def sleep_until(self, deadline_ns: int) -> None:
        """Set the virtual time to `deadline_ns` (ns) without waiting; do nothing if the virtual time is later."""
        self._time[0] = max(self._time[0], deadline_ns)

    @property
    def handle(self) -> int:
        """Return the memory address of the int64 with the virtual time (ns), for compiled code."""
        return int(self._time.ctypes.data)

    @property
    def now_plug(self) -> Any:
        """Return the compiled function that reads the virtual time from the address `handle`."""
        return virtual_now

    @property
    def sleep_plug(self) -> Any:
        """Return the compiled function that sets the virtual time to a deadline instead of sleeping."""
        return virtual_sleep
