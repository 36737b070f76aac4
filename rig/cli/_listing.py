"""Read ``completion.json`` (help lines, options and kinds of values) without importing the commands."""

import json
import os
from functools import cache
from typing import Any

from rig.core import extras

NAME = "completion.json"
FILE = os.path.join(os.path.dirname(__file__), NAME)  # pathlib takes longer to import than this to read


@cache
def listing() -> dict[str, Any]:
    """Return the core's ``completion.json``: names and options of the commands, names of estimators and signals."""
    with open(FILE, encoding="utf-8") as file:
        read: dict[str, Any] = json.load(file)
    return read


@cache
def commands() -> dict[str, Any]:
    """Return help line and options of each command, also of optional packages, by the words that call the command."""
    found = dict(listing()["commands"])
    for table in extras.tables():
        if "commands" in table.rows:
            try:
                with open(os.path.join(table.folder, NAME), encoding="utf-8") as file:
                    found |= json.load(file)
            except (OSError, ValueError, TypeError):
                continue  # the command still runs; it is listed without its line
    return found


def help_line(words: str) -> str:
    """Return the first sentence of the help of the command with these words; "" if no help can be read."""
    return str(commands().get(words, {}).get("help", ""))
