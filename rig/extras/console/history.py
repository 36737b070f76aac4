"""The last minute or more of a control loop in a memory of fixed size.

The newest rows (one for each tick) are stored completely, older rows in buckets. A bucket stores the least and the
greatest value of each column over `BUCKET` rows, so that no spike is lost when a minute at 20 kHz is drawn as a
thousand points.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.sample import COLUMNS, ROW

Floats = NDArray[np.float64]

BUCKET = 32  # rows
RAW_ROWS = 1 << 17  # 6.5 s at 20 kHz, two minutes at 1 kHz
BUCKETS = 1 << 16  # 105 s at 20 kHz
NAMES = tuple(column.name for column in COLUMNS)
_PLACES = {name: place for place, name in enumerate(NAMES)}


@dataclass(frozen=True, slots=True, eq=False)
class HistoryExcerpt:
    """Points of some columns over a range of rows, for a scope.

    Attributes
    ----------
    first, step
        Number of the first row, and number of rows that each point combines.
    times
        Time of the first row of each point since the loop's first row (s, device clock).
    low, high
        Least and greatest value of each column (columns × points); the same array if `step` is 1.
    """

    first: int
    step: int
    times: Floats
    low: Floats
    high: Floats


class History:
    """Rows of one control loop, numbered from 0 in the order of arrival.

    `rows` is the number of rows that have arrived, `start_ns` the time of the first row (ns, device clock).
    """

    def __init__(self, raw_rows: int = RAW_ROWS, buckets: int = BUCKETS) -> None:
        self._raw = np.zeros(raw_rows, ROW)
        self._times = np.zeros(buckets)
        self._low = np.zeros((len(NAMES), buckets))
        self._high = np.zeros((len(NAMES), buckets))
        self.clear()

    def clear(self) -> None:
        """Discard all rows; call this before the rows of another loop are added."""
        self.rows = 0
        self._buckets = 0
        self.start_ns = 0

    def add(self, rows: NDArray[np.void]) -> None:
        """Append rows of the loop, and update the buckets."""
        if self.rows == 0 and len(rows):
            self.start_ns = int(rows["device_time"][0])
        most = len(self._raw) // 2
        for part in (rows[place : place + most] for place in range(0, len(rows), most)):
            self._raw[np.arange(self.rows, self.rows + len(part)) % len(self._raw)] = part
            self.rows += len(part)
            self._fill_buckets()

    def _fill_buckets(self) -> None:
        whole = self.rows // BUCKET
        if whole == self._buckets:
            return
        rows = self._rows_of(self._buckets * BUCKET, whole * BUCKET)
        places = np.arange(self._buckets, whole) % len(self._times)
        self._times[places] = self._seconds(rows[::BUCKET])
        values = _values(rows, NAMES).reshape(len(NAMES), -1, BUCKET)
        self._low[:, places], self._high[:, places] = values.min(axis=2), values.max(axis=2)
        self._buckets = whole

    @property
    def oldest_row(self) -> int:
        """Number of the oldest row that is stored completely, not only in a bucket."""
        return max(0, self.rows - len(self._raw))

    def raw(self, first: int, last: int) -> NDArray[np.void]:
        """Return a copy of the rows from `first` to `last` - 1 that are still stored completely."""
        return self._rows_of(max(first, self.oldest_row), min(last, self.rows))

    def row_at(self, seconds: float) -> int:
        """Return the row at `seconds` (s since the first row) rounded up to a multiple of 32, at most the row count."""
        if self._buckets == 0 or seconds >= self._newest_s():
            return self.rows
        kept = np.arange(max(0, self._buckets - len(self._times)), self._buckets)
        return int(kept[0] + np.searchsorted(self._times[kept % len(self._times)], seconds)) * BUCKET

    def seconds_at(self, row: int) -> float:
        """Return the time of a row since the first row (s, device clock); the row must be stored completely."""
        return float(self._seconds(self._raw[row % len(self._raw)][np.newaxis])[0])

    def received_at(self, row: int) -> float | None:
        """Return the time at which the host received a row (ms since 1970); None if the row has not arrived."""
        if not 0 <= row < self.rows:
            return None
        age_ns = time.monotonic_ns() - int(self._raw["received_at"][row % len(self._raw)])
        return (time.time_ns() - age_ns) * 1e-6

    def seconds_of(self, device_time_ns: int) -> float:
        """Convert a time of the device's clock (ns) to seconds since the first row."""
        return (device_time_ns - self.start_ns) * 1e-9

    def _newest_s(self) -> float:
        return self.seconds_at(self.rows - 1)

    def cut(self, columns: Sequence[str], first: int, last: int, step: int) -> HistoryExcerpt:
        """Return points of some columns from row `first` to `last` - 1, each point over `step` rows.

        Only complete points are returned. If rows are stored only in buckets (minima and maxima of 32 rows), `step` is
        rounded up to whole buckets. Rows that are in no bucket any more are left out.
        """
        last = min(last, self.rows)
        if first >= self.oldest_row:
            return self._of_rows(columns, max(0, first), last, step)
        step = -(-step // BUCKET) * BUCKET
        first = max(first, (self._buckets - len(self._times)) * BUCKET, 0)
        return self._of_buckets(columns, first, last, step)

    def _of_rows(self, columns: Sequence[str], first: int, last: int, step: int) -> HistoryExcerpt:
        points = max(0, (last - first) // step)
        places = np.arange(first, first + points * step) % len(self._raw)
        # Column by column: whole rows of all that is kept would be 40 MB, and STOP waits meanwhile.
        values = np.array([self._raw[name][places] for name in columns], np.float64)
        times = (self._raw["device_time"][places[::step]] - self.start_ns) * 1e-9
        if step == 1:
            return HistoryExcerpt(first, 1, times, values, values)
        values = values.reshape(len(columns), points, step)
        return HistoryExcerpt(first, step, times, values.min(axis=2), values.max(axis=2))

    def _of_buckets(self, columns: Sequence[str], first: int, last: int, step: int) -> HistoryExcerpt:
        each = step // BUCKET
        begin = -(-first // BUCKET)
        points = max(0, (min(last // BUCKET, self._buckets) - begin) // each)
        places = np.arange(begin, begin + points * each) % len(self._times)
        which = np.array([_PLACES[name] for name in columns])
        low = self._low[np.ix_(which, places)].reshape(len(which), points, each).min(axis=2)
        high = self._high[np.ix_(which, places)].reshape(len(which), points, each).max(axis=2)
        return HistoryExcerpt(begin * BUCKET, step, self._times[places[::each]], low, high)

    def _rows_of(self, first: int, last: int) -> NDArray[np.void]:
        return self._raw[np.arange(first, last) % len(self._raw)]

    def _seconds(self, rows: NDArray[np.void]) -> Floats:
        return (rows["device_time"] - self.start_ns) * 1e-9


def _values(rows: NDArray[np.void], columns: Sequence[str]) -> Floats:
    return np.array([rows[name] for name in columns], np.float64).reshape(len(columns), len(rows))
