"""Read TOML files, check them by a dataclass, and report all problems at once.

Experiments, protocols of studies and descriptions of boards are such files; each kind of file is declared as a
`FileKind`. This file checks type and range of each key alone; the module that declares a kind checks rules between
keys.

`rig.config`, sessions, the boards of `rig.firmware`, the data sheets of `rig.experiments` and the console call it. It
must not depend on a certain kind of file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Generic, TypeVar, get_type_hints

from rig.config._files import LEAVES, Table, flatten, nest, read_toml, tidy
from rig.config._problems import Problem, config_error, did_you_mean
from rig.config._table import ConfigKey, parameters_of, sections_of, shown
from rig.core.deferred import pydantic
from rig.core.quantity import STRICT
from rig.core.sample import Motion

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

__all__ = [
    "FileKind",
    "Problem",
    "apply_changes",
    "better",
    "config_error",
    "did_you_mean",
    "flatten",
    "nest",
    "parse_table",
    "place",
    "plain",
    "read_toml",
    "tidy",
    "value_at",
]

T = TypeVar("T")

_WRITE = {
    "number": "write a number, without quotes",
    "whole number": "write a whole number, without quotes",
    "true or false": "write true or false, without quotes",
    "text": "write text in quotes",
    "choice": "write one of the allowed values exactly as it is listed",
    "list of number": "write numbers in brackets, like [0.0, 0.5]",
    "list of whole number": "write whole numbers in brackets, like [1, 7]",
    "list of text": 'write texts in brackets, like ["a", "b"]',
}


@dataclass(frozen=True)
class FileKind(Generic[T]):
    """A kind of TOML file, such as an experiment or the protocol of a study.

    Attributes
    ----------
    root
        Dataclass of the file's content; its fields are the sections.
    whole
        Name of the content in messages, like "the experiment".
    also
        Further keys that a file may have at the top level.
    otherwise
        Alternative remedy for a missing key, as the end of a sentence; may be empty.
    """

    root: type[T]
    whole: str
    also: tuple[str, ...] = ()
    otherwise: str = ""

    def parameters(self) -> Mapping[str, ConfigKey]:
        """Return the description of each key of such a file, by the key's dotted name."""
        root: Any = self.root  # mypy finds type[T] not hashable
        return parameters_of(root)

    def sections(self) -> Mapping[str, tuple[str, ...]]:
        """Return the names of the keys in each section of such a file, by the section's dotted name."""
        root: Any = self.root
        return sections_of(root, self.also)

    def known_instead(self, section: str, leaf: str) -> str:
        """Return the remedy for an unknown key `leaf`: a close key of its section, or this key in other sections."""
        siblings = self.sections().get(section, ())
        elsewhere = [key.replace("[]", "") for key in self.parameters() if key.rpartition(".")[2] == leaf]
        otherwise = (
            f"did you mean {' or '.join(elsewhere)}?" if elsewhere else f"known keys: {', '.join(siblings)}"
        )
        return did_you_mean(leaf, siblings, otherwise)


def parse_table(kind: FileKind[T], table: Table, motion: Motion | None) -> tuple[T | None, list[Problem]]:
    """Return the content of a table as the kind's dataclass (None if invalid), and the problems of single keys.

    `table` is the file as nested dicts with text keys (`rig.config._files.tidy`). `motion` is the rig's motion, for
    units in messages; None when it is unknown.
    """
    problems = list(_mistaken_choices(kind, table))
    # Validated as JSON, because strict validation of Python objects accepts instances of the dataclasses only.
    text = json.dumps(_jsonable(table))
    try:
        root: Any = kind.root
        return _adapter(root).validate_json(text), problems
    except pydantic.ValidationError as error:
        found = [_problem_of(e, kind, table, motion) for e in error.errors(include_url=False)]
        return None, list(dict.fromkeys(found)) + problems


def apply_changes(
    kind: FileKind[T], described: T, changes: Table, motion: Motion | None
) -> tuple[T, list[Problem]]:
    """Return a copy of a checked dataclass with some keys changed, and the problems of the new values.

    `changes` are nested tables (`rig.config._files.nest`). In a field that is a mapping with arbitrary keys, new
    entries are added to the present ones. `motion` is the rig's motion, for units in messages; None when it is unknown.
    """
    making = _Changing(changes)
    result = making.section(described, changes, ())
    problems = [_problem_of(error, kind, table, motion) for error, table in making.errors]
    return result, [*dict.fromkeys(problems), *_mistaken_choices(kind, changes)]


class _Changing:
    """A changed copy of nested dataclasses in progress: it collects pydantic's errors, each with the invalid values."""

    def __init__(self, whole: Table) -> None:
        self._whole = whole
        self.errors: list[tuple[Any, Table]] = []

    def section(self, section: Any, changes: Table, path: tuple[str, ...]) -> Any:
        kind: Any = type(section)
        known = _names(kind)
        before = len(self.errors)
        new = {
            name: self._field(section, name, changes[name], (*path, name))
            for name in known
            if name in changes
        }
        for name in (name for name in changes if name not in known):
            self._refused("unexpected_keyword_argument", (*path, name))
        if len(self.errors) > before:
            return section
        try:
            return replace(section, **new)
        except ValueError as error:  # a dataclass that checks its own keys against each other
            given = nest({".".join(path): plain(section) | changes})
            self.errors.append(({"type": "value_error", "loc": path, "ctx": {"error": error}}, given))
            return section

    def _field(self, section: Any, name: str, value: Any, path: tuple[str, ...]) -> Any:
        now = getattr(section, name)
        if not is_dataclass(now):
            joins = isinstance(now, Mapping) and isinstance(value, dict)
            return self._leaf(type(section), name, {**now, **value} if joins else value, path)
        if isinstance(value, dict):
            return self.section(now, value, path)
        self._refused("dataclass_type", path)
        return now

    def _leaf(self, section: type, name: str, value: Any, path: tuple[str, ...]) -> Any:
        try:
            return _adapter_of_key(section, name).validate_json(json.dumps(_jsonable(value)))
        except pydantic.ValidationError as error:
            found = error.errors(include_url=False)
            self.errors += [({**one, "loc": (*path, *one["loc"])}, self._whole) for one in found]
            return value

    def _refused(self, why: str, path: tuple[str, ...]) -> None:
        self.errors.append(({"type": why, "loc": path}, self._whole))


def plain(value: Any) -> Any:
    """Return a dataclass as nested dicts with lists instead of tuples; fields with value None are omitted."""
    kind: Any = type(value)  # mypy finds types not hashable
    if kind in LEAVES:
        return value
    if is_dataclass(value):
        inner = ((name, getattr(value, name)) for name in _names(kind))
        return {name: plain(v) for name, v in inner if v is not None}
    if isinstance(value, tuple):
        return [plain(inner) for inner in value]
    return dict(value) if isinstance(value, Mapping) else value


def value_at(table: Any, path: Iterable[str]) -> Any:
    """Return the value in nested dicts and lists at a path of keys and list indices; None if there is no value."""
    value: Any = table
    for part in path:
        if isinstance(value, list) and part.isdecimal():
            value = value[int(part)] if int(part) < len(value) else None
        else:
            value = value.get(part) if isinstance(value, dict) else None
    return value


def place(path: Sequence[str]) -> str:
    """Return the path of a key as text; the second table of [[condition]] is ``condition 2``."""
    text = ""
    for part in path:
        text += f" {int(part) + 1}" if part.isdecimal() else f".{part}"
    return text.removeprefix(".")


@cache
def _names(section: Any) -> tuple[str, ...]:
    return tuple(item.name for item in fields(section))


@cache
def _adapter(root: type) -> Any:
    return pydantic.TypeAdapter(root)


@cache
def _adapter_of_key(section: type, name: str) -> Any:
    hint = get_type_hints(section, include_extras=True)[name]
    return pydantic.TypeAdapter(hint, config=STRICT)


def _jsonable(value: Any) -> Any:
    """Return a copy of `value` for JSON: what JSON cannot represent becomes infinity or [], which no key accepts."""
    if isinstance(value, dict):
        return {key: _jsonable(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_jsonable(inner) for inner in value]
    if isinstance(value, int) and value.bit_length() > 1024:  # no float is that large
        return math.inf
    return value if type(value) in LEAVES or isinstance(value, int | float | str) else []


def _problem_of(error: ErrorDetails, kind: FileKind[Any], table: Table, motion: Motion | None) -> Problem:
    path, pattern = _within_leaf([str(part) for part in error["loc"]], kind)
    key, section, leaf = ".".join(pattern), ".".join(pattern[:-1]), path[-1] if path else ""
    where, value = place(path), value_at(table, path)
    if error["type"] == "unexpected_keyword_argument":
        return Problem(where, "", "is not a known key", kind.known_instead(section, leaf))
    owner = kind.parameters().get(section)
    if owner is not None and owner.kind == "table":
        return Problem(where, shown(value), f"must be {owner.values}", f"write {owner.values}")
    parameter = kind.parameters().get(key)
    if parameter is None or parameter.kind == "table":
        return _wrong_section(error, kind, key, path, value)
    must = f"{parameter.expected(motion)} ({parameter.meaning})"
    if error["type"] == "missing":
        above = f"[{place(path[:-1])}]"
        remedy = f"add {leaf} under {above}" + (f", or {kind.otherwise}" if kind.otherwise else "")
        return Problem(where, "", f"is missing: {must}", remedy)
    return Problem(where, shown(value), f"must be {must}", better(value, parameter))


def _within_leaf(path: list[str], kind: FileKind[Any]) -> tuple[list[str], list[str]]:
    """Return the path of a pydantic error up to a key of the file, and the parts of this key's dotted name."""
    pattern: list[str] = []
    for length, part in enumerate(path, start=1):
        if part.isdecimal() and pattern and ".".join(pattern) not in kind.parameters():
            pattern[-1] += "[]"
            continue
        pattern.append(part)
        parameter = kind.parameters().get(".".join(pattern))
        if parameter is not None:
            end = length + 1 if parameter.kind == "table" else length
            return path[:end], pattern + path[length:end]
    return path, pattern


def _wrong_section(
    error: ErrorDetails, kind: FileKind[Any], key: str, path: Sequence[str], value: Any
) -> Problem:
    name = f"[{place(path)}]" if key else kind.whole
    contents = ", ".join(kind.sections().get(key, ())) or "numbers by name"
    if error["type"] == "missing":
        remedy = "add it" + (f", or {kind.otherwise}" if kind.otherwise else "")
        listed = kind.sections().get(f"{key}[]")
        what = (
            f"one or more tables [[{key}]] with {', '.join(listed)}" if listed else f"a table with {contents}"
        )
        return Problem(name, "", f"is missing: {what}", remedy)
    if error["type"] == "value_error":  # a dataclass that checks its own keys against each other
        message = str(error["ctx"]["error"])
        found = ", ".join(f"{k} = {shown(v)}" for k, v in value.items() if k in message) or "none of them"
        return Problem(name, "", f"{message} (given: {found})", "change these keys together")
    listed = kind.sections().get(f"{key}[]")
    if listed:
        must = f"must be one or more tables [[{key}]] with {', '.join(listed)}"
        return Problem(place(path), shown(value), must, f"write [[{key}]] and its keys below it")
    return Problem(
        place(path) or kind.whole,
        shown(value),
        f"must be a table with {contents}",
        f"write {name} and its keys below it",
    )


def better(value: Any, parameter: ConfigKey) -> str:
    """Return a remedy for a wrong value: the most similar allowed word, or how to write a value of this type."""
    kind = parameter.kind
    if kind == "choice" and isinstance(value, str):
        known = [choice for choice in parameter.choices if isinstance(choice, str)]
        return did_you_mean(value, known, "write one of the allowed words")
    if kind == "whole number" and isinstance(value, float) and value.is_integer():
        return (
            "write a whole number in this range"
            if parameter.bounds
            else f"write {int(value)}, without a decimal point"
        )
    if "number" in kind and isinstance(value, int | float) and not isinstance(value, bool):
        return _WRITE[kind] if kind.startswith("list") else "choose a value in this range"
    return _WRITE[kind]


def _mistaken_choices(kind: FileKind[Any], table: Table) -> Iterator[Problem]:
    """Yield a problem for each key with true or 1.0 in place of the allowed integer 1, which Python considers equal."""
    root: Any = kind.root
    for key, parameter in _numbered_keys(root):
        value = value_at(table, key.split("."))
        if isinstance(value, bool | float) and value in parameter.choices:
            must = f"must be {parameter.expected(None)} ({parameter.meaning})"
            yield Problem(key, shown(value), must, better(value, parameter))


@cache
def _numbered_keys(root: Any) -> tuple[tuple[str, ConfigKey], ...]:
    found = parameters_of(root).items()
    return tuple(
        (key, one) for key, one in found if not all(isinstance(choice, str) for choice in one.choices)
    )
