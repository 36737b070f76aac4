"""Clocks for Python and the compiled loop: the system's monotonic clock, and a virtual clock that jumps.

Devices and their ports use it. It must not read the time of day, which can be set back.
"""

from __future__ import annotations

import time
from typing import Any, Protocol

import numpy as np

from rig.realtime.system import monotonic_now, monotonic_sleep, virtual_now, virtual_sleep


class Clock(Protocol):
    """Interface of a clock for Python and the loop. All times are nanoseconds from an arbitrary origin."""

    virtual: bool

    def now_ns(self) -> int:
        """Return the present time (ns), from an arbitrary origin."""
        ...

    def sleep_until(self, deadline_ns: int) -> None:
        """Sleep until the deadline (ns); waking up may take some more time."""
        ...

    @property
    def handle(self) -> int:
        """Return the first argument of `now_plug` and `sleep_plug`."""
        ...

    @property
    def now_plug(self) -> Any:
        """Return the compiled function that reads the clock, of type `rig.realtime.plugs.NOW`."""
        ...

    @property
    def sleep_plug(self) -> Any:
        """Return the compiled function that sleeps until a deadline, of type `rig.realtime.plugs.WAIT`."""
        ...


class MonotonicClock:
    """CLOCK_MONOTONIC on Linux, the counter of `time.perf_counter` on other systems; it is never set back."""

    virtual = False
    handle = 0

    def now_ns(self) -> int:
        """Return the present monotonic time (ns)."""
        # On Linux CLOCK_MONOTONIC. `time.monotonic` of Windows has steps of 16 ms before Python 3.13.
        return time.perf_counter_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        """Sleep until an absolute deadline (ns), so that late waking does not add up over several calls."""
        remaining = deadline_ns - time.perf_counter_ns()
        if remaining > 0:
            time.sleep(remaining * 1e-9)

    @property
    def now_plug(self) -> Any:
        """Return the compiled function that reads the clock by clock_gettime."""
        return monotonic_now

    @property
    def sleep_plug(self) -> Any:
        """Return the compiled function that sleeps by clock_nanosleep."""
        return monotonic_sleep


class VirtualClock:
    """A clock whose time the caller advances; no real time passes while it sleeps."""

    virtual = True

    def __init__(self, start_ns: int = 0) -> None:
        self._time = np.array([start_ns], dtype=np.int64)

    def now_ns(self) -> int:
        """Return the present virtual time (ns)."""
        return int(self._time[0])

    def sleep_until(self, deadline_ns: int) -> None:
        """Set the time to the deadline (ns), unless the deadline has passed."""
        self._time[0] = max(self._time[0], deadline_ns)

    @property
    def handle(self) -> int:
        """Return the address of the word with the time, which compiled code reads."""
        return int(self._time.ctypes.data)

    @property
    def now_plug(self) -> Any:
        """Return the compiled function that reads the virtual time."""
        return virtual_now

    @property
    def sleep_plug(self) -> Any:
        """Return the compiled function that sets the virtual time."""
        return virtual_sleep
