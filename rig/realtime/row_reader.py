"""Read the new rows of a loop's ring as an observer: the loop neither waits for its readers nor registers them.

The console and LSL follow a run with it. It must not write to the ring.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.realtime.control_words import HEAD
from rig.realtime.ring import Ring


class RowReader:
    """Copies out what has come since the last call, from the oldest row that the ring still has.

    Attributes
    ----------
    rows
        Rows handed out so far.
    lost
        Rows that were overwritten before they were copied.
    """

    def __init__(self, ring: Ring) -> None:
        self._ring = ring
        self._next = 0
        self.rows = self.lost = 0

    def new(self) -> NDArray[np.void]:
        """Return the new rows (`rig.core.sample.ROW`), oldest first; what the loop overtook meanwhile is lost."""
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
