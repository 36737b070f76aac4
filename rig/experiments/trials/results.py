"""Write results of many trials to disk: a Parquet table with a row for each trial, and a summary in JSON.

Maps, designs, measured impedances, studies and papers use this module. The table's metadata contain the unit of each
column and the plan. This module must not load all rows into memory, because a table may be larger than the memory, nor
depend on the meaning of a column.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from rig.core.deferred import parquet, pyarrow
from rig.recording.files import plain_errors, whole_file

BATCH = 4096  # rows
KEY = b"rig.plan"


def make_directory(directory: Path) -> None:
    """Create a directory and its parents; raise `RecordingError` if the system does not allow it."""
    with plain_errors("make", directory):
        directory.mkdir(parents=True, exist_ok=True)


def write_document(path: Path, document: Mapping[str, Any]) -> None:
    """Write `document` to a JSON file, and overwrite an existing file; raise `RecordingError` if writing fails."""
    with whole_file(path, overwrite=True) as file:
        file.write(json.dumps(document, ensure_ascii=False, indent=1).encode())


def write_table(
    path: Path, rows: Iterable[Mapping[str, Any]], units: Mapping[str, str], plan: Mapping[str, Any]
) -> int:
    """Write rows of numbers, strings, booleans and None to a Parquet table; return the number of rows.

    Parameters
    ----------
    path
        Path of the file; an existing file is overwritten.
    rows
        Rows as mappings from column name to value; all rows have the same columns.
    units
        Unit of each column by its name; a column that is missing in `units` has no unit.
    plan
        Plan of the trials, as JSON values, stored in the table's metadata.

    Raises
    ------
    RecordingError
        The file cannot be written.
    """
    left = iter(rows)
    first = list(islice(left, BATCH))
    fields = [
        pyarrow.field(name, _type(name, first), metadata={"unit": units.get(name, "")})
        for name in (first[0] if first else {})
    ]
    schema = pyarrow.schema(fields, metadata={KEY: json.dumps(plan)})
    written = 0
    with (
        whole_file(path, overwrite=True) as file,
        parquet.ParquetWriter(file, schema, compression="zstd") as writer,
    ):
        for batch in _batches(first, left):
            writer.write_table(pyarrow.Table.from_pylist(batch, schema=schema))
            written += len(batch)
    return written


def _batches(first: list[Any], left: Iterator[Any]) -> Iterator[list[Any]]:
    batch = first
    while batch:
        yield batch
        batch = list(islice(left, BATCH))


def _type(name: str, rows: list[Any]) -> Any:
    """Return the Arrow type of a column by its first value that is not None; boolean if all values are None."""
    value = next((row[name] for row in rows if row[name] is not None), False)
    for kind, arrow in ((bool, pyarrow.bool_()), (int, pyarrow.int64()), (float, pyarrow.float64())):
        if isinstance(value, kind):
            return arrow
    return pyarrow.string()
