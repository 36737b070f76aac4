"""JSON with one spelling for one content, so that equal headers are equal bytes.

Keys are sorted, no blanks, UTF-8. Floats are written with the shortest digits that read back to the same
bits; the three values that JSON lacks are the strings ``"NaN"``, ``"Infinity"`` and ``"-Infinity"``, which
`float` understands.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from os import PathLike, fspath
from typing import Any

import numpy as np


def plain(value: Any) -> Any:  # noqa: PLR0911  (a table of cases)
    """Reduce to what JSON holds: dict, list, str, int, float, bool, None.

    Accepts mappings with string keys, sequences, numpy scalars and arrays, dataclasses, enumerations and
    paths; raises `TypeError` for anything else, because a header must not hold what only this program could
    read.
    """
    match value:
        case Enum():
            return plain(value.value)
        case None | bool() | str():
            return value
        case np.generic() | np.ndarray():
            return plain(value.tolist())
        case int():
            return int(value)
        case float():
            return float(value) if math.isfinite(value) else _spell(value)
        case Mapping():
            return {_key(key): plain(item) for key, item in value.items()}
        case list() | tuple():
            return [plain(item) for item in value]
        case PathLike():
            return fspath(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    raise TypeError(f"a recording's header cannot hold a {type(value).__name__}")


def canonical_json(value: Any) -> bytes:
    """Return the one spelling of `value` as UTF-8."""
    text = json.dumps(
        plain(value), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return text.encode("utf-8", "backslashreplace")


def _spell(value: float) -> str:
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"


def _key(key: Any) -> str:
    if not isinstance(key, str):
        raise TypeError(f"keys of a recording's header are strings, not {type(key).__name__}")
    return str(key)
