"""Recordings as Parquet: the format for storage, which pandas, polars, DuckDB, MATLAB and PlotJuggler open.

Unit and meaning of a column are metadata of its field (``unit``, ``description``). Header, trailer, whether the
recording is complete, and its lost parts are metadata of the file, as JSON under the keys in `KEYS`, with a checksum of
these metadata and all columns. pyarrow is imported only when a function of this module is called.
"""

import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import parquet, pyarrow
from rig.core.errors import RecordingError
from rig.core.regular_file import open_regular
from rig.recording._shape import parse_json
from rig.recording.canonical import canonical_json
from rig.recording.data import Loss, Recording
from rig.recording.files import plain_errors
from rig.recording.header import check_version, dtype_of, schema_of

KEYS = (b"rig.header", b"rig.trailer", b"rig.complete", b"rig.lost")
CHECKSUM_KEY = b"rig.crc32"
# Rows of a row group, which is in memory twice while a recording is written.
GROUP_ROWS = 1 << 17
# Columns of at most this size are decoded together; those of a long recording one by one.
READ_BYTES = 1 << 25


def has_pyarrow() -> bool:
    """Return True if pyarrow is installed, which is needed to read and write Parquet."""
    try:
        return bool(parquet.ParquetFile)
    except ImportError:
        return False


def check_pyarrow() -> None:
    """Raise `RecordingError` if pyarrow is not installed, which is needed for Parquet and for the import of CSV."""
    if not has_pyarrow():
        raise RecordingError(
            "Parquet needs pyarrow, which is not installed",
            remedy="pip install pyarrow, or use .rigcap captures",
        )


def write_parquet(file: BinaryIO, recording: Recording) -> None:
    """Write a recording to `file` as Parquet; equal recordings give equal bytes with the same version of pyarrow."""
    check_pyarrow()
    units, descriptions, dtype = recording.units, recording.descriptions, recording.rows.dtype
    fields = [
        pyarrow.field(
            name,
            pyarrow.from_numpy_dtype(dtype[name]),
            nullable=False,
            metadata={"unit": units[name], "description": descriptions[name]},
        )
        for name in recording.names
    ]
    lost = [asdict(loss) for loss in recording.lost]
    facts = (recording.header, recording.trailer, recording.complete, lost)
    metadata = {key: canonical_json(fact) for key, fact in zip(KEYS, facts, strict=True)}
    metadata[CHECKSUM_KEY] = _checksum(metadata, (recording.column(name) for name in recording.names))
    schema = pyarrow.schema(fields, metadata=metadata)
    with parquet.ParquetWriter(file, schema, compression="zstd", **_encodings(dtype)) as writer:
        for first in range(0, max(1, len(recording)), GROUP_ROWS):
            rows = recording.rows[first : first + GROUP_ROWS]
            writer.write_table(
                pyarrow.Table.from_arrays([_to_arrow(rows, name) for name in recording.names], schema=schema)
            )


def _to_arrow(rows: NDArray[np.void], name: str) -> Any:
    # pyarrow.array would import pandas, if installed, to check where the column comes from.
    column = np.ascontiguousarray(rows[name])
    return pyarrow.Array.from_buffers(
        pyarrow.from_numpy_dtype(column.dtype), len(column), [None, pyarrow.py_buffer(column)]
    )


def _checksum(metadata: Mapping[bytes, bytes], columns: Iterable[NDArray[Any]]) -> bytes:
    """Return the CRC-32 of the metadata (in the order of `KEYS`) and the columns, as 8 hex digits."""
    # Parquet checks neither footer nor page heads.
    crc = _checksum_of(metadata)
    for column in columns:
        crc = zlib.crc32(column.data, crc)
    return b"%08x" % crc


def _checksum_of(metadata: Mapping[bytes, bytes]) -> int:
    return zlib.crc32(b"".join(metadata[key] for key in KEYS))


def _encodings(dtype: np.dtype[np.void]) -> dict[str, Any]:
    # Neighbouring floats share exponents; most whole numbers repeat or rise evenly.
    chosen = {
        name: "BYTE_STREAM_SPLIT" if dtype[name].kind == "f" else "DELTA_BINARY_PACKED"
        for name in dtype.names or ()
        if dtype[name].kind == "f" or dtype[name].itemsize >= 4
    }
    return {"use_dictionary": False, "column_encoding": chosen}


def read_parquet(path: Path, columns: Collection[str] | None = None) -> Recording:
    """Read a Parquet recording; with `columns`, the rows have only these columns, but the header describes all of them.

    Raise `RecordingError` if the file is not a recording, or if any bit of a column was changed.
    """
    with _open_file(path) as file:
        return _recording(path, file, _metadata(path, file.schema_arrow), columns)


def read_parquet_facts(path: Path) -> Recording:
    """Return what a Parquet recording has besides its rows (header and trailer), as a recording without rows."""
    with _open_file(path) as file:
        metadata = _metadata(path, file.schema_arrow)
        return _facts(path, metadata)


@contextmanager
def _open_file(path: Path) -> Iterator[Any]:
    check_pyarrow()
    with plain_errors("read", path), open_regular(path) as file:
        try:
            yield parquet.ParquetFile(file)
        except (pyarrow.ArrowException, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            reason = f"{error}".partition("\n")[0]
            raise RecordingError(f"{path} is damaged: {reason}", remedy="restore it from a copy") from error


def _metadata(path: Path, schema: Any) -> dict[bytes, bytes]:
    metadata: dict[bytes, bytes] = schema.metadata or {}
    if not any(key in metadata for key in KEYS):
        raise RecordingError(
            f"{path} is not a recording: this Parquet file was written by another program",
            remedy="give a .parquet or .rigcap file that haptic-rig wrote",
        )
    return metadata


def _to_numpy(chunk: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return a chunk of a pyarrow column as an array over the same memory; raise `ValueError` if it has nulls."""
    # pyarrow's own conversion imports pandas.
    if chunk.null_count:
        raise ValueError(
            f"a column of the type {dtype} has {chunk.null_count} empty values; a recording has none"
        )
    if chunk.type != pyarrow.from_numpy_dtype(dtype):
        raise ValueError(f"a column has the type {chunk.type} instead of {dtype}")
    return np.frombuffer(chunk.buffers()[1], dtype, len(chunk), chunk.offset * dtype.itemsize)


def _recording(
    path: Path, file: Any, metadata: dict[bytes, bytes], columns: Collection[str] | None
) -> Recording:
    facts = _facts(path, metadata)
    dtype = facts.rows.dtype if columns is None else dtype_of(schema_of(facts.header["schema"], columns))
    rows, wanted = np.empty(file.metadata.num_rows, dtype), set(dtype.names or ())
    for name, row, values in _checked_columns(file, metadata, facts):
        if name in wanted:
            rows[name][row : row + len(values)] = values
    return replace(facts, rows=rows)


def is_stored(path: Path, expected: Recording, names: Collection[str]) -> bool:
    """Return True if the columns `names` of a Parquet recording equal the columns of `expected` bit by bit."""
    with _open_file(path) as file:
        metadata = _metadata(path, file.schema_arrow)
        facts = _facts(path, metadata)
        if not set(names) <= set(facts.names) or file.metadata.num_rows != len(expected):
            return False
        return all(
            name not in names or values.tobytes() == expected.rows[name][row : row + len(values)].tobytes()
            for name, row, values in _checked_columns(file, metadata, facts)
        )


def _checked_columns(
    file: Any, metadata: Mapping[bytes, bytes], facts: Recording
) -> Iterator[tuple[str, int, NDArray[Any]]]:
    """Yield column name, first row and values of each chunk; at the end, raise `ValueError` for a wrong checksum."""
    stored: list[str] = file.schema_arrow.names
    if set(stored) != set(facts.names):
        raise ValueError("the columns of the file differ from those that its header lists")
    together = max(1, READ_BYTES // (8 * file.metadata.num_rows + 1))
    crc = _checksum_of(metadata)
    for first in range(0, len(stored), together):
        names = stored[first : first + together]
        table = file.read(columns=names)
        for name in names:
            row = 0
            for chunk in table.column(name).chunks:
                if len(chunk):
                    values = _to_numpy(chunk, facts.rows.dtype[name])
                    crc = zlib.crc32(values.data, crc)
                    yield name, row, values
                    row += len(values)
    if b"%08x" % crc != metadata[CHECKSUM_KEY]:
        raise ValueError("the checksum of header and columns does not match: the contents have changed")


def _facts(path: Path, metadata: dict[bytes, bytes]) -> Recording:
    header, trailer, complete, lost = (parse_json(metadata[key]) for key in KEYS)
    check_version(path, header.get("version"))
    rows = np.empty(0, dtype_of(header["schema"]))
    return Recording(header, rows, trailer, complete is True, tuple(Loss(**loss) for loss in lost), path)
