"""Time as an object: the kernel's monotonic clock, or a virtual one that jumps, for Python and the compiled loop.

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
        """Sleep until the deadline; return then or later by the time that waking takes."""
        ...

    @property
    def handle(self) -> int:
        """Return the first argument of `now_plug`."""
        ...

    @property
    def now_plug(self) -> Any:
        """Return the compiled function that reads the clock, of type `rig.realtime.plugs.NOW`."""
        ...

    @property
    def sleep_plug(self) -> Any:
        """Return the compiled `sleep_until`, of type `rig.realtime.plugs.WAIT`."""
        ...


class MonotonicClock:
    """CLOCK_MONOTONIC on Linux, the counter behind `time.perf_counter` elsewhere: never set back."""

    virtual = False
    handle = 0

    def now_ns(self) -> int:
        """Return the present monotonic time (ns)."""
        # On Linux CLOCK_MONOTONIC. `time.monotonic` of Windows has steps of 16 ms before Python 3.13.
        return time.perf_counter_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        """Sleep until the deadline; absolute, so that waking late does not add up."""
        remaining = deadline_ns - time.perf_counter_ns()
        if remaining > 0:
            time.sleep(remaining * 1e-9)

    @property
    def now_plug(self) -> Any:
        """Return the compiled call of clock_gettime."""
        return monotonic_now

    @property
    def sleep_plug(self) -> Any:
        """Return the compiled call of clock_nanosleep."""
        return monotonic_sleep


class VirtualClock:
    """A number that is advanced by hand; one second of it costs what its events cost."""

    virtual = True

    def __init__(self, start_ns: int = 0) -> None:
        self._time = np.array([start_ns], dtype=np.int64)

    def now_ns(self) -> int:
        """Return the present virtual time (ns)."""
        return int(self._time[0])

    def sleep_until(self, deadline_ns: int) -> None:
        """Jump to the deadline, or stay when it has passed."""
        self._time[0] = max(self._time[0], deadline_ns)

    @property
    def handle(self) -> int:
        """Return the address of the number, which compiled code reads."""
        return int(self._time.ctypes.data)

    @property
    def now_plug(self) -> Any:
        """Return the compiled function that reads the virtual time."""
        return virtual_now

    @property
    def sleep_plug(self) -> Any:
        """Return the compiled function that sets the virtual time."""
        return virtual_sleep
