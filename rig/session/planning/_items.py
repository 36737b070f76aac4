"""Questions of the questionnaire: convert them for the operator's user interface, and parse the answers.

The engine and the operator's user interface use it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rig.session.planning._names import normalise

if TYPE_CHECKING:
    from rig.session.planning._protocol import Item


def describe_item(item: Item) -> dict[str, Any]:
    """Return a question of the questionnaire as a dictionary for the operator's user interface."""
    return {
        "name": item.name,
        "text": item.text,
        "kind": item.kind,
        "lowest": item.lowest,
        "highest": item.highest,
        "choices": list(item.choices),
    }


def parse_answer(item: Mapping[str, Any], text: str) -> str | int | None:
    """Return a typed answer in the form that the log stores; None if the answer is not valid.

    A choice may be given by its words or by its number, from 1; words have priority.
    """
    text, kind = text.strip(), item["kind"]
    if kind == "text":
        return text
    if kind == "choice" and normalise(text) in item["choices"]:
        return normalise(text)
    if re.fullmatch(r"-?[0-9]{1,9}", text) is None:
        return None
    number = int(text)
    if kind == "choice":
        return str(item["choices"][number - 1]) if 1 <= number <= len(item["choices"]) else None
    return number if item["lowest"] <= number <= item["highest"] else None


def describe_answer(item: Mapping[str, Any]) -> str:
    """Return a short description of the valid answers to a question, e.g. "a number from 1 to 7"."""
    if item["kind"] == "choice":
        return f"a number from 1 to {len(item['choices'])}, or one of: {', '.join(item['choices'])}"
    return f"a number from {item['lowest']} to {item['highest']}" if item["kind"] == "scale" else "any text"
