"""A recording in memory: the one type that every reader returns and every writer takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import pandas
from rig.core.errors import RecordingError, RigError


@dataclass(frozen=True, slots=True)
class Loss:
    """A stretch of a file that could not be used, and the rows in it as far as the rest of the file shows."""

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


@dataclass(frozen=True, eq=False)
class Recording:
    """What one trial left: header, rows, trailer, and what is missing.

    Attributes
    ----------
    header
        Everything known before the trial (`rig.recording.header.make_header`).
    rows
        Structured array, one row a tick; its fields are those of the file: `rig.core.sample.ROW`, and in simulation
        the truth.
    trailer
        How and why the trial ended, with its statistics; None when it could not be written.
    complete
        Whether the writer reached its end. A recording cut off by the death of its process is incomplete but usable.
    lost
        What the reader had to skip.
    path
        The file it was read from.
    """

    header: dict[str, Any]
    rows: NDArray[np.void]
    trailer: dict[str, Any] | None = None
    complete: bool = True
    lost: tuple[Loss, ...] = ()
    path: Path | None = None

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.rows)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self.rows.dtype.names or ())

    @property
    def units(self) -> dict[str, str]:
        """SI unit of each column."""
        return {column["name"]: column["unit"] for column in self.header["schema"]["columns"]}

    @property
    def descriptions(self) -> dict[str, str]:
        """Meaning of each column."""
        return {column["name"]: column["description"] for column in self.header["schema"]["columns"]}

    @property
    def experiment(self) -> dict[str, Any]:
        """The parameters in effect."""
        return dict(self.header.get("experiment") or {})

    @property
    def has_truth(self) -> bool:
        """Whether the simulation's truth is among the columns."""
        return "position_true" in self.names

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Time from the first row, in s: the device's clock, or the host's where the device gave none."""
        for name in ("device_time", "received_at"):
            if name in self.names:
                time: NDArray[np.int64] = self.rows[name]
                if len(time) and np.any(time != time[0]):
                    return np.asarray((time - time[0]) * 1e-9, dtype=np.float64)
        return np.zeros(len(self.rows))

    def column(self, name: str) -> NDArray[Any]:
        """Return one column as a contiguous array; raises `RecordingError` for an unknown name."""
        if name not in self.names:
            raise RecordingError(
                f"the recording has no column {name!r}", remedy=f"its columns are {', '.join(self.names)}"
            )
        return np.ascontiguousarray(self.rows[name])

    def to_numpy(self) -> dict[str, NDArray[Any]]:
        """Return all columns, each as a contiguous array of its own."""
        return {name: self.column(name) for name in self.names}

    def to_pandas(self) -> Any:
        """Return a DataFrame whose `attrs` hold ``units``, ``descriptions`` and ``header``.

        Raises `RigError` when pandas is not installed.
        """
        try:
            frame = pandas.DataFrame(self.to_numpy())
        except ImportError as error:
            raise RigError("pandas is not installed", remedy="pip install pandas") from error
        frame.attrs = {"units": self.units, "descriptions": self.descriptions, "header": self.header}
        return frame
