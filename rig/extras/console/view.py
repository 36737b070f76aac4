"""One page's scope: its columns, window and trigger, and the points that the page has not received yet.

`client` sends these points; errands pack points of recordings in the same way, and `page/link.js` unpacks them.
"""

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.core.errors import ConfigError
from rig.extras.console.history import NAMES, History, HistoryExcerpt
from rig.extras.console.trigger import CONTACT, Trigger

POINTS = 1000  # of a window: about one for each pixel
SHORTEST_S, LONGEST_S = 0.01, 60.0
MOST_COLUMNS = 12
DEFAULT = ("position", "velocity", "effort_wanted", "effort_sent", "effort_applied", "penetration")


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewRequest:
    """Settings of a page's scope; without a `trigger` the scope shows rows as they arrive."""

    columns: tuple[str, ...] = DEFAULT
    window_s: float = 2.0
    trigger: Trigger | None = None

    def __post_init__(self) -> None:
        unknown = [name for name in (*self.columns, *self._trigger_column()) if name not in NAMES]
        if unknown:
            raise ConfigError(f"unknown column {unknown[0]!r}", remedy=f"choose from {', '.join(NAMES)}")
        if not 1 <= len(self.columns) <= MOST_COLUMNS:
            raise ConfigError(
                f"{len(self.columns)} columns cannot be shown", remedy=f"choose 1 to {MOST_COLUMNS} columns"
            )
        if not SHORTEST_S <= self.window_s <= LONGEST_S:
            raise ConfigError(
                f"a window of {self.window_s:g} s is out of range",
                remedy=f"choose {SHORTEST_S:g} to {LONGEST_S:g} s",
            )
        if self.trigger is not None and not 0.0 <= self.trigger.before <= 1.0:
            raise ConfigError(
                f"trigger.before = {self.trigger.before:g} is out of range",
                remedy="give the share of the window before the trigger, 0 to 1",
            )

    def _trigger_column(self) -> tuple[str, ...]:
        return () if self.trigger is None or self.trigger.on == CONTACT else (self.trigger.on,)


class View:
    """Reader of a control loop's samples for the scope of one page; `rate` is in rows a second (Hz)."""

    def __init__(self, history: History, rate: float, shown: ViewRequest) -> None:
        self._history = history
        self._window = max(2, round(shown.window_s * rate))
        self._step = max(1, self._window // POINTS)
        self._shown = shown
        self._fresh = True
        self._next = max(0, history.rows - self._window) // self._step * self._step
        self._searched = history.rows
        self._hit: int | None = None
        self._hit_s = 0.0
        self._done = False

    def frames(self) -> Iterator[bytes]:
        """Yield the packed frames to send to the page now: new points or, with a trigger, complete sweeps."""
        trigger = self._shown.trigger
        if trigger is None:
            last = self._history.rows // self._step * self._step
            if last > self._next or self._fresh:
                cut = self._history.cut(self._shown.columns, self._next, last, self._step)
                newest = self._history.received_at(last - 1)
                yield pack(cut, self._shown.columns, kind="live", fresh=self._fresh, newest=newest)
                self._next, self._fresh = last, False
            return
        while not self._done and (sweep := self._sweep(trigger)) is not None:
            yield sweep

    def _sweep(self, trigger: Trigger) -> bytes | None:
        history = self._history
        before = round(trigger.before * self._window)
        if self._hit is None:
            begin = max(self._searched - 1, history.oldest_row, 0)
            rows = history.raw(begin, history.rows)
            place = trigger.first(rows)
            self._searched = history.rows
            if place is None:
                return None
            self._hit, self._hit_s = begin + place, history.seconds_at(begin + place)
        last = self._hit - before + self._window
        if history.rows < last:
            return None
        cut = history.cut(self._shown.columns, self._hit - before, last, self._step)
        self._hit, self._searched, self._done = None, last, trigger.single
        return pack(cut, self._shown.columns, kind="sweep", fresh=True, at=self._hit_s)


def pack(cut: HistoryExcerpt, columns: tuple[str, ...], **header: Any) -> bytes:
    """Pack points for a scope as bytes: length of the header, JSON header, times, least and greatest values.

    The length is a uint32, numbers are float64 and begin at a multiple of 8 bytes. Without the greatest values if each
    point is one row.
    """
    header_fields = {
        **header,
        "first": cut.first,
        "step": cut.step,
        "columns": columns,
        "points": len(cut.times),
    }
    text = json.dumps(header_fields).encode()
    text += b" " * (-(4 + len(text)) % 8)
    arrays = [cut.times, cut.low, *([] if cut.step == 1 else [cut.high])]
    numbers = b"".join(np.ascontiguousarray(array, "<f8").tobytes() for array in arrays)
    return struct.pack("<I", len(text)) + text + numbers
