"""Canonical JSON: equal contents give equal bytes.

Keys are sorted; the text is UTF-8 without blanks between its parts. Floats have the shortest digits from which the same
bits are read back; NaN and infinities, which JSON lacks, are the strings ``"NaN"``, ``"Infinity"`` and ``"-Infinity"``,
which the Python function `float` accepts.

Writers of recordings, trials and the console use this module. Do not change the format: headers of new and old
recordings would no longer be equal byte for byte.
"""

import json
import math
from typing import Any

from rig.core.present import plain


def lossless(value: Any) -> Any:
    """Convert `value` to JSON types (dict, list, str, numbers, bool, None), with NaN and infinities as strings."""
    return plain(value, _spell)


def canonical_json(value: Any) -> bytes:
    """Return `value` as JSON in UTF-8 with sorted keys, so that equal values give equal bytes."""
    text = json.dumps(
        lossless(value), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return text.encode("utf-8", "backslashreplace")


def _spell(value: float) -> str:
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
