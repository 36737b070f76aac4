"""The device's clock on the host's, while the loop runs: the line of `rig.core.clock_fit` through the exchanges so far.

The loop leaves each exchange in its ring for a tenth of a second and more; who looks more often misses none. The
line gets better while a run lasts, so a recording, which is fitted at its end, differs from what was streamed by less
than `sd_ns` and the asymmetry bound say.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from rig.core.clock_fit import ClockFit, as_exchanges, fit_if_possible
from rig.realtime.ring import Ring
from rig.recording.timing import device_times

KEPT = 1024  # exchanges: a minute and a half
EAGER = 16  # exchanges up to which each is a reason to fit anew
EVERY = 6  # further exchanges between two fits


class LiveClock:
    """Host times of a running loop's device times; `fitted` once an exchange has been seen."""

    def __init__(self) -> None:
        self._stamps: deque[tuple[int, ...]] = deque(maxlen=KEPT)
        self._seen = 0
        self._since_fit = 0
        self._fit: ClockFit | None = None
        self._shift: int | None = None

    @property
    def fitted(self) -> bool:
        """Return True if there is a line."""
        return self._fit is not None

    @property
    def bound_ns(self) -> int | None:
        """Return the bound of the error of host times (ns), asymmetry plus three standard uncertainties; or None."""
        fit = self._fit
        return None if fit is None else fit.asymmetry_bound_ns + round(3.0 * fit.offset_sd_ns)

    def look(self, ring: Ring) -> None:
        """Take the newest exchange, if it is new, and fit when that is worth it."""
        done, stamps = ring.clock_exchange()
        if stamps is None or done == self._seen:
            return
        self._seen = done
        self._stamps.append(stamps)
        self._since_fit += 1
        if len(self._stamps) <= EAGER or self._since_fit >= EVERY:
            self._since_fit = 0
            self._fit = fit_if_possible(as_exchanges(self._stamps)) or self._fit

    def host_of(self, rows: NDArray[np.void], device_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Host times (ns) of device times on the scale of these rows' device_time.

        Without a line: as much after the first row's receipt as the device's clock says, later by the link's delay.
        """
        first: NDArray[np.int64] = rows["device_time"][:1]
        received = int(rows["received_at"][0])
        if self._fit is None:
            return device_ns - int(first[0]) + received
        if self._shift is None:  # 32 bits of the device's clock wrap: which round the rows began in
            self._shift = int(device_times(first, self._fit, received)[0]) - int(first[0])
        return self._fit.host_of(device_ns + self._shift)
