"""Items of the questionnaire: as a desk is given them, and what is an answer."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rig.session.planning._names import normalise

if TYPE_CHECKING:
    from rig.session.planning._protocol import Item


def describe_item(item: Item) -> dict[str, Any]:
    """Return an item of the questionnaire as a desk is given it."""
    return {
        "name": item.name,
        "text": item.text,
        "kind": item.kind,
        "lowest": item.lowest,
        "highest": item.highest,
        "choices": list(item.choices),
    }


def parse_answer(item: Mapping[str, Any], text: str) -> str | int | None:
    """Return an answer as it is stored; None if it is not valid, so that the item is asked again.

    A choice may be given by its number, from 1, or by its words, which win. What comes out may be parsed again.
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
    """Return a short description of a valid answer."""
    if item["kind"] == "choice":
        return f"a number from 1 to {len(item['choices'])}, or one of: {', '.join(item['choices'])}"
    return f"a number from {item['lowest']} to {item['highest']}" if item["kind"] == "scale" else "any text"
