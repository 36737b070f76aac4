"""What ``completion.json`` lists of the commands: their lines, options and kinds of values, without importing them."""

from __future__ import annotations

import json
import os
from functools import cache
from typing import Any

FILE = os.path.join(
    os.path.dirname(__file__), "completion.json"
)  # pathlib takes longer to import than this to read


@cache
def listing() -> dict[str, Any]:
    """Return commands by their words, and names of built-in parts, as they were when the file was written."""
    with open(FILE, encoding="utf-8") as file:
        read: dict[str, Any] = json.load(file)
    return read
