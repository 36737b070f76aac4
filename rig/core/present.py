"""Output forms of every result: JSON types for machines, rows and tables for people.

A result is a frozen dataclass. `plain` converts it to JSON types: its fields under their names, and the properties
marked `reported`. Fields that are not in its ``repr`` (traces, raw rows) are not in JSON either.

For people, a result has a list of `Item` in reading order: headings, rows of label, value and unit, tables and checks.
The terminal (`rig.cli.output.show`) shows that list; pages (``items.html.j2`` in `rig.views.report`) show its tables.

Results of every package use it; commands and pages show them. It must not print, draw, or depend on a certain result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import cache, partial
from os import PathLike, fspath
from typing import Any, Generic, TypeVar, overload

from rig.core.check import Check

Value = TypeVar("Value")

_AS_IT_IS = {type(None), bool, int, str}  # most of what a header holds; `plain` knows their subclasses, too


class reported(Generic[Value]):  # noqa: N801  (used as `property` is)
    """Decorator like `property`; the function `plain` includes the value in a result's JSON like a field."""

    def __init__(self, getter: Callable[[Any], Value]) -> None:
        self.getter = getter
        self.__doc__ = getter.__doc__

    @overload
    def __get__(self, instance: None, owner: type) -> reported[Value]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...
    def __get__(self, instance: object | None, owner: type) -> reported[Value] | Value:
        """Return the property's value for an instance of the result; for the class, return the descriptor itself."""
        return self if instance is None else self.getter(instance)


def plain(value: Any, not_finite: Callable[[float], Any] = lambda _: None) -> Any:  # noqa: PLR0911  (a table of cases)
    """Convert a result to JSON types: dict, list, str, int, float, bool, None.

    Parameters
    ----------
    value
        Dataclasses, mappings, sequences, numpy scalars and arrays (complex ones as real and imaginary part),
        enumerations and paths, nested.
    not_finite
        Function that returns the substitute for NaN or an infinity; by default None.

    Raises
    ------
    TypeError
        The value contains an object of another type.
    """
    if type(value) in _AS_IT_IS:
        return value
    if type(value) is float:
        return value if math.isfinite(value) else not_finite(value)
    inner = partial(plain, not_finite=not_finite)
    match value:
        case Enum():
            return inner(value.value)
        case None | bool() | str():
            return value
        case int():
            return int(value)
        case float():
            return float(value) if math.isfinite(value) else not_finite(value)
        case dict() | Mapping():
            return {
                key if type(key) is str else _key(key): item if type(item) in _AS_IT_IS else inner(item)
                for key, item in value.items()
            }
        case list() | tuple():
            return [item if type(item) in _AS_IT_IS else inner(item) for item in value]
        case PathLike():
            return fspath(value)
    if hasattr(value, "tolist"):  # numpy's, without importing numpy where no value needs it
        complexes = value.dtype.kind == "c"
        return inner({"real": value.real, "imaginary": value.imag} if complexes else value.tolist())
    if hasattr(value, "as_mapping"):  # a result whose JSON is not its fields
        return inner(value.as_mapping())
    if is_dataclass(value) and not isinstance(value, type):
        return {name: inner(getattr(value, name)) for name in _names(type(value))}
    raise TypeError(f"a {type(value).__name__} cannot be written as JSON; make it a dict, list or number")


def _key(key: Any) -> str:
    key = key.value if isinstance(key, Enum) else key
    if not isinstance(key, str | int):
        raise TypeError(f"a key of a JSON object must be text or an integer, and is a {type(key).__name__}")
    return str(key)


@cache
def _names(result: type) -> list[str]:
    also = [
        name
        for base in reversed(result.__mro__)
        for name, of in vars(base).items()
        if isinstance(of, reported)
    ]
    return list(dict.fromkeys([*(item.name for item in fields(result) if item.repr), *also]))


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a result for people: a label, a value with its SI unit, and a note.

    Attributes
    ----------
    label
        Name of the value; empty on a line that continues the previous line.
    value
        A number or a text; None if it is unknown.
    unit
        Unit of a number; empty for a pure number.
    note
        Context of the value: a limit, a comparison, an uncertainty.
    digits
        Significant digits of a number.
    """

    label: str
    value: float | int | str | bool | None
    unit: str = ""
    note: str = ""
    digits: int = 4

    @property
    def text(self) -> str:
        """Return value, unit and note of this line as one text, for example ``412 ns, at most``."""
        shown = " ".join(part for part in (written(self.value, self.digits), self.unit) if part)
        return ", ".join(part for part in (shown, self.note) if part)


@dataclass(frozen=True, slots=True)
class Table:
    """Table of a result for people. The first `words` columns are texts, aligned left; the others are numbers."""

    head: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    words: int = 1

    @property
    def cells(self) -> list[list[str]]:
        """Return the cells of all rows of the table as formatted texts."""
        return [[written(cell) for cell in row] for row in self.rows]


Item = str | Row | Table | Check
"""A heading, a line, a table or a check."""


def page_items(items: Sequence[Item]) -> list[dict[str, Any]]:
    """Return each item of a result as a dict of texts for a web page; the first key names the kind of the item."""

    def one(item: Item) -> dict[str, Any]:
        match item:
            case Row():
                return {"row": item.label, "text": item.text}
            case Table():
                return {
                    "table": item.caption,
                    "head": list(item.head),
                    "rows": item.cells,
                    "words": item.words,
                }
            case Check():
                return {
                    "check": item.name,
                    "outcome": item.outcome.value,
                    "text": item.text,
                    "remedy": item.remedy,
                }
        return {"heading": item}

    return [one(item) for item in items]


def written(value: Any, digits: int = 4) -> str:
    """Return a value as text: a float with `digits` digits, "yes" or "no" for a bool, "unknown" for None and NaN."""
    match value:
        case None:
            return "unknown"
        case bool():
            return "yes" if value else "no"
        case float() if math.isinf(value):
            return "∞" if value > 0 else "−∞"
        case float() if math.isnan(value):
            return "unknown"
        case float():
            return f"{value:.{digits}g}"
    return str(value)


def duration(value_ns: float) -> str:
    """Return a time in ns as text with three digits in a suitable unit: ``412 ns``, ``87.5 µs``, ``-1.2 ms``."""
    for limit, factor, unit in ((1e3, 1.0, "ns"), (1e6, 1e-3, "µs"), (1e9, 1e-6, "ms")):
        if abs(value_ns) < 0.9995 * limit:
            return f"{value_ns * factor:.3g} {unit}"
    return f"{value_ns * 1e-9:.4g} s"
