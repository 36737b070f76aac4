"""Canonical JSON: equal contents give equal bytes.

Keys are sorted, without blanks, in UTF-8. Floats are written with the shortest digits that read back to the same
bits; the three values that JSON lacks are the strings ``"NaN"``, ``"Infinity"`` and ``"-Infinity"``, which
`float` understands.

Writers of recordings, trials and the console call it. Do not change the format: headers of old recordings would no
longer be equal byte for byte.
"""

from __future__ import annotations

import json
import math
from typing import Any

from rig.core.present import plain


def lossless(value: Any) -> Any:
    """Convert to JSON types by `rig.core.present.plain`, with NaN and infinities as strings."""
    return plain(value, _spell)


def canonical_json(value: Any) -> bytes:
    """Return `value` as canonical JSON in UTF-8."""
    text = json.dumps(
        lossless(value), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return text.encode("utf-8", "backslashreplace")


def _spell(value: float) -> str:
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
