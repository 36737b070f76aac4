"""A recording in memory: the one type that every reader returns and every writer takes.

Trials, verdicts, replays, maps, sessions, pictures, studies and `rig.testing` use it. It must not read or write a
file, nor judge the recording.
"""

from __future__ import annotations

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
    """Bytes of a file that could not be read, and the number of rows in them (None if unknown)."""

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
    """One column of a recording: one value per row, their SI unit, and the times of the rows (s).

    numpy functions accept it as an array of its values. It has no arithmetic of its own: results have other units.
    """

    name: str
    values: NDArray[Any]
    unit: str
    description: str
    time_s: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype, copy=copy)

    def brief(self) -> list[Item]:
        """Return meaning, range and number of rows of the column, to print."""
        rows = [Row("meaning", self.description), Row("rows", len(self))]
        if len(self):
            low, high = (float(value) for value in (self.values.min(), self.values.max()))
            rows += [Row("least", low, self.unit), Row("greatest", high, self.unit)]
        return [f"{self.name} ({self.unit})", *rows]


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Shown, Drawn):
    """Recording of one trial: header, rows, trailer, and lost parts of the file.

    Attributes
    ----------
    header
        Everything known before the trial (`rig.recording.header.make_header`).
    rows
        Structured array with one row per tick: the columns of `rig.core.sample.ROW`, and in simulation also those of
        `rig.core.sample.TRUTH_COLUMNS`.
    trailer
        How and why the trial ended, with its statistics; None if the file has none, as after a crash.
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
        """Return the names of the columns, in their order."""
        return tuple(self.rows.dtype.names or ())

    @property
    def units(self) -> dict[str, str]:
        """Return the SI unit of each column, by name."""
        return {column["name"]: column["unit"] for column in self.header["schema"]["columns"]}

    @property
    def descriptions(self) -> dict[str, str]:
        """Return the meaning of each column, by name."""
        return {column["name"]: column["description"] for column in self.header["schema"]["columns"]}

    @property
    def experiment(self) -> dict[str, Any]:
        """Return the parameters of the experiment that were in effect, as nested dictionaries."""
        return dict(self.header.get("experiment") or {})

    @property
    def has_truth(self) -> bool:
        """Return True if the columns include the true signals of a simulation."""
        return "position_true" in self.names

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Time of each row since the first row (s), by the device's clock, or by the host's if it is not recorded."""
        for name in ("device_time", "received_at"):
            if name in self.names:
                time: NDArray[np.int64] = self.rows[name]
                # A constant column means that this clock was not recorded.
                if len(time) and np.any(time != time[0]):
                    return np.asarray((time - time[0]) * 1e-9, dtype=np.float64)
        return np.zeros(len(self.rows))

    def __getitem__(self, name: str) -> Column:
        """Return one column with unit, meaning and times; raise `RecordingError` for an unknown name."""
        values = self.column(name)
        return Column(name, values, self.units[name], self.descriptions[name], self.time_s)

    def column(self, name: str) -> NDArray[Any]:
        """Return one column as a contiguous array; raise `RecordingError` for an unknown name."""
        if name not in self.names:
            close = get_close_matches(name, self.names, n=1)
            remedy = f"did you mean {close[0]}?" if close else f"its columns are {', '.join(self.names)}"
            raise RecordingError(f"the recording has no column {name!r}", remedy=remedy)
        return np.ascontiguousarray(self.rows[name])

    def to_numpy(self) -> dict[str, NDArray[Any]]:
        """Return all columns, each as a contiguous array of its own."""
        return {name: self.column(name) for name in self.names}

    def to_pandas(self) -> Any:
        """Return a DataFrame whose `attrs` hold ``units``, ``descriptions`` and ``header``.

        Raise `RigError` when pandas is not installed.
        """
        try:
            frame = pandas.DataFrame(self.to_numpy())
        except ImportError as error:
            raise _not_installed("pandas") from error
        frame.attrs = {"units": self.units, "descriptions": self.descriptions, "header": self.header}
        return frame

    def to_xarray(self) -> Any:
        """Return a Dataset over ``time`` (s); each variable has ``units`` and ``long_name``.

        Raise `RigError` when xarray is not installed.
        """
        try:
            columns = {name: ("time", values) for name, values in self.to_numpy().items()}
            found = xarray.Dataset(columns, coords={"time": ("time", self.time_s, {"units": "s"})})
        except ImportError as error:
            raise _not_installed("xarray") from error
        for name, unit in self.units.items():
            found[name].attrs.update(units=unit, long_name=self.descriptions[name])
        return found

    def brief(self) -> list[Item]:
        """Return creation time, file, reason of the end, verdict, and numbers of rows and columns, to print."""
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
        """Return the rows of `brief`, and a table of all columns with unit and meaning."""
        columns = [(name, self.units[name], self.descriptions[name]) for name in self.names]
        return [*self.brief(), Table(("column", "unit", "meaning"), columns, words=3)]


def _not_installed(library: str) -> RigError:
    return RigError(f"{library} is not installed", remedy="install it: pip install 'haptic-rig[data]'")
