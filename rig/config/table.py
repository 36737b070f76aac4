"""The table of all parameters, read off the annotations of the sections: key, type, range, unit, meaning.

Error messages, the listing of an experiment and the schema for editors are three views of this table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from operator import attrgetter
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, cast, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt, MinLen

from rig.config.sections import Experiment
from rig.quantity import Quantity
from rig.sample import UNITS, Motion, unit_of

_TYPES: dict[Any, str] = {float: "number", int: "whole number", bool: "true or false", str: "text"}
_BOUNDS: tuple[tuple[type, str], ...] = ((Gt, ">"), (Ge, "≥"), (Lt, "<"), (Le, "≤"))


@dataclass(frozen=True, slots=True)
class Parameter:
    """One key of an experiment file."""

    key: str
    section: type  # the dataclass that has the field
    kind: str  # "number", "whole number", "true or false", "text", "choice" or "table"
    choices: tuple[int | str, ...]
    bounds: tuple[str, ...]  # like "> 0"
    unit: str  # or quantity, see rig.sample.unit_of
    meaning: str

    def unit_for(self, motion: Motion | None) -> str:
        """Unit for a rotary or linear rig, both when the motion is not known, nothing for a pure number."""
        if motion is None and self.unit in UNITS:
            return " or ".join(UNITS[self.unit].values())
        return "" if self.unit == "1" else unit_of(self.unit, motion or "rotary")

    def expected(self, motion: Motion | None) -> str:
        """What a value must be, in words, with range and unit."""
        match self.kind:
            case "choice":
                return "one of " + ", ".join(shown(choice) for choice in self.choices)
            case "true or false":
                return self.kind
            case "text":
                return "text, not empty" if self.bounds else "text"
            case "table":
                return "a table of numbers"
        unit = self.unit_for(motion)
        limits = " and ".join(self.bounds) or ("in" if unit else "")
        return " ".join(word for word in ("a", self.kind, limits, unit) if word)


class Described(NamedTuple):
    """One line of a listing."""

    key: str
    value: Any
    unit: str
    meaning: str


@cache
def parameters() -> Mapping[str, Parameter]:
    """Return every parameter by its dotted key, in the order of the sections, without `realtime`."""
    table = {parameter.key: parameter for parameter in _walk(Experiment, "")}
    del table["realtime"]
    return table


@cache
def sections() -> Mapping[str, tuple[str, ...]]:
    """Return the keys inside each table of a file, by the table's dotted name ("" for the top)."""
    found: dict[str, tuple[str, ...]] = {"": ("preset", *(f.name for f in fields(Experiment)))}
    for key in parameters():
        while "." in key:
            key, _, leaf = key.rpartition(".")  # noqa: PLW2901
            if leaf not in found.get(key, ()):
                found[key] = (*found.get(key, ()), leaf)
    return found


def _walk(section: type, prefix: str) -> Iterator[Parameter]:
    hints = get_type_hints(section, include_extras=True)
    for item in fields(section):
        hint, key = hints[item.name], prefix + item.name
        if is_dataclass(hint):
            yield from _walk(cast("type", hint), f"{key}.")
        else:
            yield _parameter(section, key, hint)


def _parameter(section: type, key: str, hint: Any) -> Parameter:
    if get_origin(hint) is not Annotated:
        raise TypeError(f"{section.__name__}: field {key} has no Quantity")
    kind, *metadata = get_args(hint)
    if get_origin(kind) is UnionType:
        kind = next(arm for arm in get_args(kind) if arm is not NoneType)
    quantity = next(m for m in metadata if isinstance(m, Quantity))
    bounds = [
        f"{sign} {getattr(m, type(m).__name__.lower()):g}"
        for m in metadata
        for bound, sign in _BOUNDS
        if isinstance(m, bound)
    ]
    bounds += ["not empty" for m in metadata if isinstance(m, MinLen)]
    is_choice = get_origin(kind) is Literal
    name = "choice" if is_choice else _TYPES.get(kind, "table")
    choices = get_args(kind) if is_choice else ()
    return Parameter(key, section, name, choices, tuple(bounds), quantity.unit, quantity.meaning)


def describe(experiment: Experiment, under: str = "") -> tuple[Described, ...]:
    """List an experiment for printing: key, value, unit (resolved by the rig's motion) and meaning.

    Parameters
    ----------
    experiment
        What to list.
    under
        Only this section, like ``wall`` or ``rig.limits``; everything when empty.
    """
    motion = experiment.rig.motion
    lines: list[Described] = []
    for key, parameter in parameters().items():
        value = attrgetter(key)(experiment)
        if parameter.kind == "table":
            lines += [
                Described(
                    f"{key}.{name}", v, _suffix_unit(name), f"setting of {experiment.controller.estimator}"
                )
                for name, v in value.items()
            ]
        else:
            lines.append(Described(key, value, parameter.unit_for(motion), parameter.meaning))
    return tuple(line for line in lines if not under or f"{line.key}.".startswith(f"{under}."))


def json_schema() -> dict[str, Any]:
    """JSON schema of an experiment file, for editors that complete and check TOML (taplo, VS Code).

    Nothing is required in it, because a file may start from a preset.
    """
    from pydantic import TypeAdapter  # noqa: PLC0415  (slow to import, and only needed here)

    from rig.config.files import preset_names  # noqa: PLC0415

    schema = TypeAdapter(Experiment).json_schema()
    definitions: dict[str, Any] = schema["$defs"]
    for parameter in parameters().values():
        entry = definitions[parameter.section.__name__]["properties"][parameter.key.rpartition(".")[2]]
        unit = parameter.unit_for(None)
        entry["description"] = f"{parameter.meaning} [{unit}]" if unit else parameter.meaning
    for definition in (schema, *definitions.values()):
        definition.pop("required", None)
    schema["properties"]["preset"] = {
        "enum": list(preset_names()),
        "description": "what this file starts from",
    }
    schema["properties"]["realtime"] = {"type": "object", "description": "changes for a loop in real time"}
    return schema


def shown(value: Any) -> str:
    """Write a value as a TOML file would, shortened to one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\n", "\\n")[:60] + '"'
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, int) and value.bit_length() > 64:
        return "a number of more than 64 bits"
    return repr(value)[:60]


def _suffix_unit(name: str) -> str:
    return {"hz": "Hz", "s": "s", "a": "A", "counts": "count"}.get(name.rpartition("_")[2], "")
