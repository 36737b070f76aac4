"""Convert the device's time to the host's while the loop runs, with a line fitted to the clock exchanges so far.

The loop stores each exchange in its ring buffer for at least a tenth of a second, so that frequent readers miss none.
The line improves during a run: a recording, whose line is fitted at the end, differs from the streamed times by less
than the uncertainty `sd_ns` and the asymmetry bound.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from rig.core.clock_fit import ClockFit, as_exchanges, fit_if_possible
from rig.realtime.ring import Ring
from rig.recording.timing import device_times

KEPT = 1024  # exchanges, which are a minute and a half
EAGER = 16  # number of first exchanges after each of which the line is fitted
EVERY = 6  # further exchanges between two fits


class LiveClock:
    """Conversion of a running loop's device times to host times, by a fitted line."""

    def __init__(self) -> None:
        self._stamps: deque[tuple[int, ...]] = deque(maxlen=KEPT)
        self._seen = 0
        self._since_fit = 0
        self._fit: ClockFit | None = None
        self._shift: int | None = None

    @property
    def fitted(self) -> bool:
        """True if a line has been fitted, which needs at least one clock exchange."""
        return self._fit is not None

    @property
    def bound_ns(self) -> int | None:
        """Error bound of host times (ns): asymmetry and three standard uncertainties; None before a line is fitted."""
        fit = self._fit
        return None if fit is None else fit.asymmetry_bound_ns + round(3.0 * fit.offset_sd_ns)

    def look(self, ring: Ring) -> None:
        """Read the newest clock exchange from the loop's ring buffer `ring`, and fit the conversion to host time again.

        The first `EAGER` exchanges are fitted each, later ones every `EVERY` exchanges.
        """
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
        """Convert device times (ns, with the zero of the column `device_time` in `rows`) to host times (ns).

        Before a clock exchange, the first row's time of receipt is taken as its host time, which is late by the link's
        delay.
        """
        first: NDArray[np.int64] = rows["device_time"][:1]
        received = int(rows["received_at"][0])
        if self._fit is None:
            return device_ns - int(first[0]) + received
        if self._shift is None:
            # The device's clock has 32 bits and wraps: find the number of wraps before the first row.
            self._shift = int(device_times(first, self._fit, received)[0]) - int(first[0])
        return self._fit.host_of(device_ns + self._shift)
