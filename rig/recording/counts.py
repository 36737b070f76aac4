"""Import of CSV files of other loggers: times and encoder counts on a regular grid, with detection of lost samples.

The imported recording has no rig, virtual wall or trial: its unknown columns are NaN or 0, and
`rig.recording.origin.counts_facts` returns its rate, resolution and lost samples.

`rig recording import` and `rig recording show` use this module. It must not replace a lost sample by a guessed count.
"""

import csv as lines_of
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.control.estimators import COUNTS, age_of_last_change, unwrap, whole_numbers
from rig.core.deferred import csv, pyarrow
from rig.core.errors import ConfigError, RecordingError
from rig.core.present import Row
from rig.core.regular_file import ROWS_BYTES, open_regular
from rig.core.sample import COLUMNS, ROW, Motion, RowFlag, unit_of
from rig.recording._parquet import check_pyarrow
from rig.recording.data import Recording
from rig.recording.files import plain_errors, sha256_of
from rig.recording.header import make_header
from rig.recording.origin import COUNTS_FACTS

UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
# Relative to a period. A speed computed from one interval has the same relative error.
WORST_DEVIATION = 0.1
# A rate that differs by less from a whole number of Hz is rounded.
WHOLE_HZ = 1e-4
FEWEST = 3  # samples that show a period
# Bytes at the beginning of the file from which delimiter and header are detected.
HEAD_BYTES = 1 << 16
COMMENTS = ("#", "%")

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def read_counts(
    path: str | Path,
    *,
    count: str | int,
    resolution: float,
    time: str | int | None = None,
    time_unit: str = "s",
    period_s: float | None = None,
    width: int | None = None,
    motion: Motion = "rotary",
    delimiter: str | None = None,
) -> Recording:
    """Read times and encoder counts from a CSV file as a recording, to compare and tune velocity estimators.

    Parameters
    ----------
    path
        Text file in UTF-8. A header line is recognised; lines before it that begin with # or % are skipped. A row
        without a count or without a time counts as a lost sample.
    count, time
        Columns of counts and of times: name in the header line, or number from 0. Times are numbers, or dates as ISO
        8601.
    resolution
        Travel per count (rad or m); negative if counts fall while the position rises.
    time_unit
        Unit of times that are numbers: s, ms, us or ns.
    period_s
        Time between two rows (s). Give either `time` or `period_s`; with `period_s`, every row must be a sample.
    width
        Number of bits of the counter, if it has fewer than 32 and wraps around (see `rig.estimate`).
    motion
        "rotary" (rad) or "linear" (m).
    delimiter
        Separator of columns. Default: the first of semicolon, tab and comma that occurs in the first line. With
        semicolons or tabs, numbers may have decimal commas.

    Returns
    -------
    Recording
        One row for each sample in the file; `elapsed_ticks` is above 1 in the row after lost samples.
        ``rig.export(recording, "log.parquet")`` saves the recording.

    Raises
    ------
    RecordingError
        The file cannot be read or lacks a given column; a column contains text; the counts cannot be unwrapped; times
        do not increase; or an interval differs by more than 10 % of a period from a whole number of periods.
    ConfigError
        Resolution, unit or period is invalid.
    """
    _check(resolution, time, time_unit, period_s)
    path = Path(path)
    file = _read(path, [count] if time is None else [count, time], delimiter)
    counts = _numbers(path, count, file[0])
    # A row without a count is a lost sample, not one with a count of zero.
    known = ~np.isnan(counts)
    seconds = None
    if time is not None:
        seconds, dated = _seconds(path, time, file[1], UNITS_S[time_unit])
        known &= dated
    rows = np.flatnonzero(known)
    if len(rows) < FEWEST:
        raise RecordingError(
            f"{path} has {len(rows)} rows with a count and a time; at least {FEWEST} are needed",
            remedy="check that `count` and `time` name the right columns",
        )
    if seconds is None:
        assert period_s is not None
        grid = SampleGrid(rows - rows[0], period_s, 0.0, 0.0)
        device_s = np.asarray(grid.index * period_s, dtype=np.float64)
    else:
        device_s = seconds[rows] - seconds[rows[0]]
        grid = _grid(path, device_s, rows)
    elapsed = np.diff(grid.index, prepend=grid.index[0] - 1)
    exact = file[0].to_numpy(zero_copy_only=False)[rows]
    try:
        whole = unwrap(whole_numbers(exact, COUNTS), width, elapsed)
    except ConfigError as error:
        raise RecordingError(
            f"{path}: {error.message} (rows without a count are skipped)", remedy=error.remedy
        ) from error
    facts = {
        "file": path.name,
        "sha256": sha256_of(path),
        "rate_hz": grid.rate_hz,
        "resolution": resolution,
        "width": width,
        "lost_samples": int(np.sum(elapsed - 1)),
        "gaps": int(np.count_nonzero(elapsed > 1)),
        "longest_gap": int(elapsed.max()) - 1,
        "deviation_max": None if seconds is None else grid.deviation_max,
        "deviation_rms": None if seconds is None else grid.deviation_rms,
    }
    return _recording(path, motion, facts, grid, device_s, whole, elapsed)


def count_rows(facts: Mapping[str, Any], motion: Motion) -> list[Row]:
    """Return rate (Hz), resolution (rad or m per count) and lost samples of imported counts, as lines to print."""
    rows = [
        Row("rate", facts["rate_hz"], "Hz", digits=9),
        Row("resolution", facts["resolution"], unit_of("position", motion), "a count"),
        Row(
            "lost",
            f"{facts['lost_samples']} samples in {facts['gaps']} gaps",
            note=f"{facts['longest_gap']} at most",
        ),
    ]
    if facts["width"] is not None:
        rows.append(Row("counter", facts["width"], "bits"))
    if facts["deviation_max"] is not None:
        worst, rms = facts["deviation_max"], facts["deviation_rms"]
        rows.append(
            Row(
                "intervals",
                f"{worst:.2%} of a period from the grid at most, {rms:.2%} rms",
                note="so are speeds",
            )
        )
    return rows


@dataclass(frozen=True)
class SampleGrid:
    """A regular sampling grid fitted to time stamps: grid index of each sample, and the sampling period (s).

    `deviation_max` and `deviation_rms` state how far the measured intervals deviate from whole periods (in periods).
    """

    index: Ints
    period_s: float
    deviation_max: float
    deviation_rms: float

    @property
    def rate_hz(self) -> float:
        """Sampling rate (Hz), rounded to a whole number of Hz if the rounding changes it by at most 0.01 %."""
        rate = 1.0 / self.period_s
        return float(round(rate)) if abs(rate - round(rate)) <= WHOLE_HZ * rate else rate


def _check(resolution: float, time: object, time_unit: str, period_s: float | None) -> None:
    if not (math.isfinite(resolution) and resolution != 0.0):
        raise ConfigError(
            f"resolution = {resolution!r} is not a travel per count: it must be finite and not 0",
            remedy="give rad or m per count",
        )
    if time_unit not in UNITS_S:
        raise ConfigError(
            f"time_unit = {time_unit!r} is not a unit of time", remedy=f"choose one of {', '.join(UNITS_S)}"
        )
    if (time is None) == (period_s is None):
        raise ConfigError(
            "exactly one of time and period_s must be given",
            remedy="give the column of times (time), or the seconds between rows (period_s)",
        )
    if period_s is not None and not (math.isfinite(period_s) and period_s > 0.0):
        raise ConfigError(
            f"period_s = {period_s!r} is not a sampling period: it must be above 0 and finite",
            remedy="give seconds above 0",
        )


def _read(path: Path, wanted: list[str | int], delimiter: str | None) -> list[Any]:
    """Return the columns named in `wanted` (pyarrow.ChunkedArray) with the types that pyarrow infers from the text."""
    check_pyarrow()
    with plain_errors("read", path), open_regular(path, ROWS_BYTES) as file:
        lines = file.read(HEAD_BYTES).decode("utf-8-sig", "replace").splitlines()
    skipped = next(
        (i for i, line in enumerate(lines) if line.strip() and not line.startswith(COMMENTS)), None
    )
    if skipped is None:
        raise RecordingError(f"{path} has no rows", remedy="give a CSV file of times and counts")
    between = delimiter or next((one for one in ";\t" if one in lines[skipped]), ",")
    names = [name.strip() for name in next(lines_of.reader([lines[skipped]], delimiter=between))]
    header = not all(_is_number(name) for name in names)
    comma = between != "," and any(re.search(r"\d,\d", line) for line in lines[skipped:])
    columns = [f"f{_column_number(path, one, names if header else [], len(names))}" for one in wanted]
    try:
        table = csv.read_csv(
            path,
            read_options=csv.ReadOptions(skip_rows=skipped + header, autogenerate_column_names=True),
            parse_options=csv.ParseOptions(delimiter=between),
            convert_options=csv.ConvertOptions(
                include_columns=list(dict.fromkeys(columns)),
                decimal_point="," if comma else ".",
                strings_can_be_null=True,
            ),
        )
    except pyarrow.ArrowException as error:
        reason = str(error).partition("\n")[0]
        raise RecordingError(
            f"{path} is not a CSV file whose rows have equal numbers of columns: {reason}",
            remedy="correct this row of the file",
        ) from error
    return [table.column(name) for name in columns]


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return text == ""
    return True


def _column_number(path: Path, column: str | int, names: list[str], columns: int) -> int:
    if isinstance(column, int):
        if 0 <= column < columns:
            return column
        raise RecordingError(
            f"{path} has {columns} columns; there is no column number {column}",
            remedy=f"choose a number from 0 to {columns - 1}",
        )
    if names.count(column) == 1:
        return names.index(column)
    if column in names:
        raise RecordingError(
            f"{path} has several columns with the name {column!r}",
            remedy="give the number of the column instead of its name, counted from 0",
        )
    if not names:
        raise RecordingError(
            f"{path} has no header line with column names",
            remedy=f"give the number of the column, from 0 to {columns - 1}",
        )
    close = get_close_matches(column, names, n=1)
    raise RecordingError(
        f"{path} has no column {column!r}",
        remedy=f"did you mean {close[0]!r}?" if close else f"its columns are {', '.join(names)}",
    )


def _numbers(path: Path, name: str | int, column: Any) -> Floats:
    if not (pyarrow.types.is_integer(column.type) or pyarrow.types.is_floating(column.type)):
        text = next((str(one) for one in column.to_pylist() if one is not None), "nothing")
        raise RecordingError(
            f"{path}: column {name!r} does not hold numbers in every row; it begins with {text!r}",
            remedy="choose another column, or correct the rows with text",
        )
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)


def _seconds(path: Path, name: str | int, column: Any, unit_s: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the time of each row (s, with an arbitrary zero), and a mask that is True for rows that have a time."""
    known = ~np.asarray(column.is_null().to_numpy(zero_copy_only=False), dtype=bool)
    types = pyarrow.types
    if types.is_timestamp(column.type) or types.is_time(column.type):
        unit_s = 1e-9
        wide = pyarrow.timestamp("ns") if types.is_timestamp(column.type) else pyarrow.time64("ns")
        column = column.cast(wide).cast(pyarrow.int64())
    # Whole numbers less the first one, then floats: a double does not hold every ns of a date.
    if types.is_integer(column.type):
        whole = column.fill_null(0).to_numpy(zero_copy_only=False).astype(np.int64)
        first = whole[known][:1].sum()
        return np.asarray((whole - first) * unit_s, dtype=np.float64), known
    values = _numbers(path, name, column)
    return values * unit_s, known & np.isfinite(values)


def _grid(path: Path, time_s: Floats, rows: Ints) -> SampleGrid:
    intervals = np.diff(time_s)
    back = np.flatnonzero(intervals <= 0.0)
    if len(back):
        at = int(back[0])
        raise RecordingError(
            f"{path}: time does not increase in {len(back)} rows, first in data row {rows[at + 1]}: "
            f"{time_s[at + 1]:.9g} s after {time_s[at]:.9g} s (from the first sample)",
            remedy="sort the rows; if the time stamps are too coarse for the rate, omit time and give period_s",
        )
    # The median first: a mean over all intervals would contain the gaps. Then twice, since a period from a mean of
    # intervals is not yet good enough to count the periods of a long gap.
    middle = float(np.median(intervals))
    period_s = float(np.mean(intervals[np.abs(intervals - middle) <= 0.5 * middle]))
    periods = np.maximum(np.rint(intervals / period_s), 1.0)
    period_s = float(time_s[-1] / np.sum(periods))
    periods = np.maximum(np.rint(intervals / period_s), 1.0)
    deviation = np.abs(intervals / period_s - periods)
    wrong = np.flatnonzero(deviation > WORST_DEVIATION)
    if len(wrong):
        at = int(wrong[0])
        raise RecordingError(
            f"{path}: the times are irregular: {len(wrong)} of {len(intervals)} intervals are not a whole number of "
            f"periods of {period_s:.6g} s within {WORST_DEVIATION:.0%} of a period, first before data row "
            f"{rows[at + 1]}: {intervals[at]:.6g} s, {intervals[at] / period_s:.3f} periods",
            remedy="sample with a steady clock; if only the time stamps are irregular, omit time and "
            "give period_s",
        )
    index = np.concatenate(([0], np.cumsum(periods))).astype(np.int64)
    return SampleGrid(index, period_s, float(deviation.max()), float(np.sqrt(np.mean(np.square(deviation)))))


def _recording(
    path: Path,
    motion: Motion,
    facts: dict[str, Any],
    grid: SampleGrid,
    device_s: Floats,
    counts: Ints,
    elapsed: Ints,
) -> Recording:
    header = make_header(
        rig=path.name,
        motion=motion,
        experiment={},
        identity={},
        clocks={"kind": "file"},
        seed=None,
        protocol="none",
        initial_state={},
        extra={COUNTS_FACTS: facts},
    )
    rows = np.zeros(len(counts), ROW)
    for column in COLUMNS:
        if column.dtype == "<f8":
            rows[column.name] = np.nan
    edge_age_s = age_of_last_change(counts, grid.index / facts["rate_hz"])
    rows["tick"] = np.arange(len(counts))
    rows["sample_index"] = grid.index
    rows["elapsed_ticks"] = elapsed
    rows["device_time"] = np.rint(1e9 * device_s)
    rows["count"] = counts
    rows["edge_age"] = np.rint(1e9 * edge_age_s)
    rows["position"] = facts["resolution"] * counts
    rows["flags"] = np.where(elapsed > 1, int(RowFlag.GAP), 0)
    return Recording(header, rows)
