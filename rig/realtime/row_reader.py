"""Follow a run: read the new rows of a loop's ring buffer without delaying the loop.

The console and LSL use it. The loop does not know its readers and does not wait for them. This file must not write to
the ring.
"""

import numpy as np
from numpy.typing import NDArray

from rig.realtime.control_words import HEAD
from rig.realtime.ring import Ring


class RowReader:
    """Reader that copies new rows (samples) from the ring buffer of a running loop.

    Attributes
    ----------
    rows
        Number of rows returned so far.
    lost
        Number of rows that the loop overwrote before they were copied.
    """

    def __init__(self, ring: Ring) -> None:
        self._ring = ring
        self._next = 0
        self.rows = self.lost = 0

    def new(self) -> NDArray[np.void]:
        """Return the rows (`rig.core.sample.ROW`) since the last call; those that the loop overwrote count as lost."""
        ring = self._ring
        head = ring.get(HEAD)
        first = max(self._next, head - ring.capacity)
        rows = ring.rows[np.arange(first, head) % max(1, ring.capacity)]
        # The loop may be writing row HEAD just now, over row HEAD - capacity.
        oldest = max(first, ring.get(HEAD) - ring.capacity + 1) if head > first else first
        rows = rows[min(oldest - first, len(rows)) :]
        self.lost += head - self._next - len(rows)
        self.rows += len(rows)
        self._next = head
        return rows
