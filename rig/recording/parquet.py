"""Recordings as Parquet: the form to keep, which pandas, polars, DuckDB, MATLAB and PlotJuggler open.

Unit and meaning are metadata of each field (``unit``, ``description``); header, trailer, completeness and
losses are metadata of the file, as JSON under the keys in `KEYS`, with a checksum over all of it and the
columns. pyarrow is loaded when a function here is called.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import parquet, pyarrow
from rig.core.errors import RecordingError
from rig.recording.canonical import canonical_json
from rig.recording.data import Loss, Recording
from rig.recording.files import plain_errors
from rig.recording.header import check_version, dtype_of
from rig.recording.shape import parsed

KEYS = (b"rig.header", b"rig.trailer", b"rig.complete", b"rig.lost")
CHECKSUM_KEY = b"rig.crc32"


def has_pyarrow() -> bool:
    """Whether Parquet can be written and read here."""
    try:
        return bool(parquet.ParquetFile)
    except ImportError:
        return False


def check_pyarrow() -> None:
    """Raise `RecordingError` where Parquet and CSV cannot be read."""
    if not has_pyarrow():
        raise RecordingError("Parquet needs pyarrow", remedy="pip install pyarrow, or use captures and CSV")


def write_parquet(file: BinaryIO, recording: Recording) -> None:
    """Write a recording; equal recordings give equal bytes under the same pyarrow."""
    check_pyarrow()
    units, descriptions = recording.units, recording.descriptions
    columns = recording.to_numpy()
    fields = [
        pyarrow.field(
            name,
            pyarrow.from_numpy_dtype(column.dtype),
            nullable=False,
            metadata={"unit": units[name], "description": descriptions[name]},
        )
        for name, column in columns.items()
    ]
    lost = [asdict(loss) for loss in recording.lost]
    facts = (recording.header, recording.trailer, recording.complete, lost)
    metadata = {key: canonical_json(fact) for key, fact in zip(KEYS, facts, strict=True)}
    metadata[CHECKSUM_KEY] = _checksum(metadata, columns)
    # The memory as it is: pyarrow.array would import pandas, if it is installed, to ask whether this comes from there.
    arrays = [
        pyarrow.Array.from_buffers(
            pyarrow.from_numpy_dtype(column.dtype), len(column), [None, pyarrow.py_buffer(column)]
        )
        for column in columns.values()
    ]
    table = pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields, metadata=metadata))
    parquet.write_table(table, file, compression="zstd", **_encodings(columns))


def _checksum(metadata: Mapping[bytes, bytes], columns: Mapping[str, NDArray[Any]]) -> bytes:
    """CRC-32 over metadata and columns in their order, since Parquet checks neither footer nor page heads."""
    crc = zlib.crc32(b"".join(metadata[key] for key in KEYS))
    for column in columns.values():
        crc = zlib.crc32(column.data, crc)
    return b"%08x" % crc


def _encodings(columns: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Floats by byte stream: neighbours share exponents. Whole numbers by difference: most repeat."""
    chosen = {
        name: "BYTE_STREAM_SPLIT" if column.dtype.kind == "f" else "DELTA_BINARY_PACKED"
        for name, column in columns.items()
        if column.dtype.kind == "f" or column.dtype.itemsize >= 4
    }
    return {"use_dictionary": False, "column_encoding": chosen}


def read_parquet(path: Path) -> Recording:
    """Read a sealed recording; raises `RecordingError` when it is none, or when a bit of it has changed."""
    with _opened(path) as file:
        table = file.read()
        return _recording(path, table, _metadata(path, table.schema))


def read_parquet_facts(path: Path) -> Recording:
    """A sealed recording without its rows, from the end of the file; raises `RecordingError` when it is none."""
    with _opened(path) as file:
        metadata = _metadata(path, file.schema_arrow)
        return _facts(path, metadata)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    check_pyarrow()
    with plain_errors("read", path), open(path, "rb") as file:
        try:
            yield parquet.ParquetFile(file)
        except (pyarrow.ArrowException, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise RecordingError(f"{path} is damaged", remedy=f"{error}".partition("\n")[0]) from error


def _metadata(path: Path, schema: Any) -> dict[bytes, bytes]:
    metadata: dict[bytes, bytes] = schema.metadata or {}
    if not any(key in metadata for key in KEYS):
        raise RecordingError(f"{path} is not a recording", remedy="it is Parquet that another program wrote")
    return metadata


def _to_numpy(column: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return a column of numbers without nulls from its memory, since pyarrow's own conversion imports pandas."""
    if column.null_count or column.type != pyarrow.from_numpy_dtype(dtype):
        raise ValueError(f"a column has nulls, or is {column.type} and not {dtype}")
    chunks = [
        np.frombuffer(chunk.buffers()[1], dtype, len(chunk), chunk.offset * dtype.itemsize)
        for chunk in column.chunks
        if len(chunk)
    ]
    if len(chunks) == 1:
        return chunks[0]
    return np.concatenate(chunks) if chunks else np.empty(0, dtype)


def _recording(path: Path, table: Any, metadata: dict[bytes, bytes]) -> Recording:
    facts = _facts(path, metadata)
    columns = {name: _to_numpy(table.column(name), facts.rows.dtype[name]) for name in table.column_names}
    if _checksum(metadata, columns) != metadata[CHECKSUM_KEY]:
        raise ValueError("its checksum does not match")
    rows = np.empty(table.num_rows, facts.rows.dtype)
    for name in facts.names:
        rows[name] = columns[name]
    return replace(facts, rows=rows)


def _facts(path: Path, metadata: dict[bytes, bytes]) -> Recording:
    header, trailer, complete, lost = (parsed(metadata[key]) for key in KEYS)
    check_version(path, header.get("version"))
    rows = np.empty(0, dtype_of(header["schema"]))
    return Recording(header, rows, trailer, complete is True, tuple(Loss(**loss) for loss in lost), path)
