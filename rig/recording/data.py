"""A recording in memory: the type that every reader of recordings returns and every writer accepts.

Trials, verdicts, replays, maps, sessions, plots, studies and `rig.testing` use this module. It must not read or write a
file, nor evaluate a recording.
"""

from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import pandas, xarray
from rig.core.errors import RecordingError, RigError
from rig.core.present import Item, Row, Table
from rig.core.shown import Drawn, Shown


@dataclass(frozen=True, slots=True)
class Loss:
    """A damaged or missing part of a recording file: `size` bytes at byte `offset`.

    The part contained `rows` rows, the first with the number `first_row`; `rows` is None if unknown. `reason` is a
    text, e.g. "damaged block".
    """

    reason: str
    offset: int
    size: int
    first_row: int
    rows: int | None

    def __str__(self) -> str:
        if self.rows is None:
            what = f"unknown rows from {self.first_row}"
        elif self.rows == 0:
            what = "no row"
        else:
            what = f"rows {self.first_row} to {self.first_row + self.rows - 1}"
        return f"{self.reason}: {what} ({self.size} bytes at {self.offset})"


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Column(Shown, Drawn):
    """One column of a recording: name, one value per row, SI unit, meaning, and the time of each row (s).

    numpy functions accept a `Column` as the array of its values. Arithmetic operators are not defined, because the
    result would have another unit.
    """

    name: str
    values: NDArray[Any]
    unit: str
    description: str
    time_s: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        # numpy before 2.0 does not take None.
        return np.asarray(self.values, dtype) if copy is None else np.array(self.values, dtype, copy=copy)

    def brief(self) -> list[Item]:
        """Return meaning, number of rows, minimum and maximum of the column, as lines to print."""
        rows = [Row("meaning", self.description), Row("rows", len(self))]
        if len(self):
            low, high = (float(value) for value in (self.values.min(), self.values.max()))
            rows += [Row("least", low, self.unit), Row("greatest", high, self.unit)]
        return [f"{self.name} ({self.unit})", *rows]


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Shown, Drawn):
    """Recording of one trial: header, rows, trailer, and damaged parts of the file.

    Attributes
    ----------
    header
        Everything known before the trial, as JSON types (`rig.recording.header.make_header`).
    rows
        Structured array with one row per control tick: the columns of `rig.core.sample.ROW`, and in simulation also the
        true signals (`rig.core.sample.TRUTH_COLUMNS`).
    trailer
        How and why the trial ended, with its statistics; None if the file has no trailer, as after a crash.
    complete
        True if the file has its end block. A recording whose process died is incomplete but usable.
    lost
        Damaged or missing parts of the file that the reader skipped.
    path
        File from which the recording was read; None for a recording that was made in memory.
    """

    header: dict[str, Any]
    rows: NDArray[np.void]
    trailer: dict[str, Any] | None = None
    complete: bool = True
    lost: tuple[Loss, ...] = ()
    path: Path | None = None

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in the order in which the file stores them."""
        return tuple(self.rows.dtype.names or ())

    @property
    def units(self) -> dict[str, str]:
        """SI unit of each column, by the column's name."""
        return {column["name"]: column["unit"] for column in self.header["schema"]["columns"]}

    @property
    def descriptions(self) -> dict[str, str]:
        """Meaning of each column as a text, by the column's name."""
        return {column["name"]: column["description"] for column in self.header["schema"]["columns"]}

    @property
    def experiment(self) -> dict[str, Any]:
        """All parameters of the experiment that were used in the trial, as nested dictionaries; {} if not recorded."""
        return dict(self.header.get("experiment") or {})

    @property
    def has_truth(self) -> bool:
        """True if the recording is of a simulation and has its true signals, without encoder and delays."""
        return "position_true" in self.names

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Time of each row since the first row (s), by the device's clock, or the host's if that was not recorded."""
        for name in ("device_time", "received_at"):
            if name in self.names:
                time: NDArray[np.int64] = self.rows[name]
                # A constant column means that this clock was not recorded.
                if len(time) and np.any(time != time[0]):
                    return np.asarray((time - time[0]) * 1e-9, dtype=np.float64)
        return np.zeros(len(self.rows))

    def __getitem__(self, name: str) -> Column:
        """Return a column with unit, meaning and times; raise `RecordingError` if the recording has no such column."""
        values = self.column(name)
        return Column(name, values, self.units[name], self.descriptions[name], self.time_s)

    def column(self, name: str) -> NDArray[Any]:
        """Return the values of a column as a contiguous array; raise `RecordingError` if there is no such column."""
        if name not in self.names:
            close = get_close_matches(name, self.names, n=1)
            remedy = f"did you mean {close[0]}?" if close else f"its columns are {', '.join(self.names)}"
            raise RecordingError(f"the recording has no column {name!r}", remedy=remedy)
        return np.ascontiguousarray(self.rows[name])

    def to_numpy(self) -> dict[str, NDArray[Any]]:
        """Return the values of all columns by name, each as a contiguous array."""
        return {name: self.column(name) for name in self.names}

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame with units, descriptions and header in `attrs`; raise `RigError` without pandas."""
        try:
            frame = pandas.DataFrame(self.to_numpy())
        except ImportError as error:
            raise _not_installed("pandas") from error
        frame.attrs = {"units": self.units, "descriptions": self.descriptions, "header": self.header}
        return frame

    def to_xarray(self) -> Any:
        """Return an xarray Dataset over ``time`` (s) with units as attributes; raise `RigError` without xarray."""
        try:
            columns = {name: ("time", values) for name, values in self.to_numpy().items()}
            found = xarray.Dataset(columns, coords={"time": ("time", self.time_s, {"units": "s"})})
        except ImportError as error:
            raise _not_installed("xarray") from error
        for name, unit in self.units.items():
            found[name].attrs.update(units=unit, long_name=self.descriptions[name])
        return found

    def brief(self) -> list[Item]:
        """Return creation time, file, end, outcome (stable, …), numbers of rows and columns, as lines to print."""
        trailer = self.trailer or {}
        verdict = trailer.get("verdict") or {}
        words = "; ".join([str(verdict.get("kind") or "none"), *verdict.get("reasons", ())])
        whole = "complete" if self.complete else "cut off"
        rows = [
            Row("made", str(self.header.get("created", ""))),
            Row("file", str(self.path) if self.path else "none"),
            Row("ended by", str(trailer.get("reason", "not known"))),
            Row("verdict", words),
            Row("rows", f"{len(self)} over {self.time_s[-1] if len(self) else 0.0:.4g} s, {whole}"),
            Row("columns", f"{', '.join(self.names[:6])} … ({len(self.names)})"),
        ]
        if (counts := (self.header.get("extra") or {}).get("counts")) is not None:
            rows.append(
                Row("samples", f"{counts['lost_samples']} lost in {counts['gaps']} gaps, of {counts['file']}")
            )
        if self.lost:
            rows.append(Row("lost", "; ".join(str(loss) for loss in self.lost[:2])))
        return [f"recording of {self.header.get('rig', 'a rig')}", *rows]

    def detailed(self) -> list[Item]:
        """Return a summary of the recording, and a table of all its columns with unit and meaning, to print."""
        columns = [(name, self.units[name], self.descriptions[name]) for name in self.names]
        return [*self.brief(), Table(("column", "unit", "meaning"), columns, words=3)]


def _not_installed(library: str) -> RigError:
    return RigError(f"{library} is not installed", remedy="install it: pip install 'haptic-rig[data]'")
