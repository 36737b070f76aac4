"""A loop that a test advances by hand, as other processes see it: rows in a ring, and two compared clocks."""

from typing import Any

import numpy as np

from rig.core.sample import ROW
from rig.realtime import control_words
from rig.realtime.ring import Ring

OFFSET_NS = 5_000_000_123  # host clock less device clock
WAY_NS = 50_000  # each way of an exchange
INFO = {
    "url": "sim://",
    "experiment": {
        "rig": {"name": "test-rig", "motion": "rotary"},
        "controller": {"position_rate": 1000},
        "wall": {"stiffness": 560.25, "damping": 0.75, "position": 0.0},
    },
}


class HandTurnedLoop:
    """The ring of a loop that ticks each millisecond; `published` contains all rows written so far."""

    def __init__(
        self, capacity: int = 64, *, shared: bool = False, info: dict[str, Any] | None = None
    ) -> None:
        self.ring = Ring.allocate(capacity, info=INFO if info is None else info, shared=shared)
        self.published = np.zeros(0, ROW)

    def leave(self, count: int, **columns: Any) -> None:
        """Write rows; each column is a single value or one value per row."""
        rows = np.zeros(count, ROW)
        number = len(self.published) + np.arange(count)
        rows["tick"], rows["sample_index"] = number, 100 + number
        rows["device_time"] = 1_000_000 * (100 + number)
        rows["received_at"] = rows["device_time"] + OFFSET_NS + 400_000
        for name in ("position", "velocity", "penetration", "effort_sent", "effort_applied"):
            rows[name] = np.random.default_rng(len(self.published)).normal(size=count)
        for name, values in columns.items():
            rows[name] = values
        for row in rows:
            head = self.ring.get(control_words.HEAD)
            self.ring.rows[head % self.ring.capacity] = row
            self.ring.put(control_words.HEAD, head + 1)
        self.published = np.concatenate((self.published, rows))

    def compare_clocks(self, *, late_ns: int = 0) -> None:
        """Store a clock comparison, as `rig.loop._exchange` does after a reply that is `late_ns` late."""
        done = self.ring.get(control_words.EXCHANGES)
        device = 1_000_000 * (100 + len(self.published))
        host = device + OFFSET_NS
        for i, stamp in enumerate((host - WAY_NS, device, device, host + WAY_NS + late_ns)):
            self.ring.put(control_words.CLOCK + 4 * (done % 2) + i, stamp)
        self.ring.put(control_words.EXCHANGES, done + 1)

    def end(self, reason: int = 1) -> None:
        self.ring.put(control_words.END_REASON, reason)
        self.ring.put(control_words.LOOP_DONE, 1)
