"""List all keys of a file from the annotations of its dataclass: name, type, range, unit and meaning of each key.

Error messages, the listing of an experiment and the schema for editors use the list. It exists for every dataclass
whose fields have a `rig.core.quantity.Quantity`; most functions here are about `Experiment`.
"""

import inspect  # for a description that pydantic before 2.13 leaves out
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from operator import attrgetter
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, cast, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt, MinLen

from rig.config._files import preset_names
from rig.config._sections import Experiment
from rig.core.deferred import pydantic
from rig.core.quantity import Quantity
from rig.core.sample import UNITS, Motion, unit_of

_TYPES: dict[Any, str] = {float: "number", int: "whole number", bool: "true or false", str: "text"}
_BOUNDS: tuple[tuple[type, str], ...] = ((Gt, ">"), (Ge, "≥"), (Lt, "<"), (Le, "≤"))


@dataclass(frozen=True, slots=True)
class ConfigKey:
    """Description of one key of a file: type, allowed values, unit and meaning."""

    key: str
    section: type  # the dataclass that has the field
    kind: str  # "number", "whole number", "true or false", "text", "choice", "table", or "list of …"
    choices: tuple[int | str, ...]
    bounds: tuple[str, ...]  # like "> 0"
    unit: str  # or quantity, see rig.core.sample.unit_of
    meaning: str
    values: str = ""  # what may stand in a table, in words; empty when its keys' owner says so

    def unit_for(self, motion: Motion | None) -> str:
        """Return the key's unit for a rotary or linear rig; both units if `motion` is None; "" for a pure number."""
        if motion is None and self.unit in UNITS:
            return " or ".join(UNITS[self.unit].values())
        return "" if self.unit == "1" else unit_of(self.unit, motion or "rotary")

    def expected(self, motion: Motion | None) -> str:
        """Return the allowed values of the key as text, with range and unit; both units if `motion` is None."""
        words = {
            "choice": "one of " + ", ".join(shown(choice) for choice in self.choices),
            "true or false": self.kind,
            "text": "text, not empty" if self.bounds else "text",
            "table": "a table of numbers",
            "list of text": "a list of texts",
        }
        return words.get(self.kind) or self._numbers(self.unit_for(motion))

    def _numbers(self, unit: str) -> str:
        bounds = [bound for bound in self.bounds if bound != "not empty"]
        limits = " and ".join(bounds) or ("in" if unit else "")
        listed = self.kind.startswith("list of ")
        text = " ".join(word for word in ("a", self.kind + "s" * listed, limits, unit) if word)
        return f"{text}, at least one" if len(bounds) < len(self.bounds) else text


class ListedKey(NamedTuple):
    """One line in the listing of an experiment's keys: key, value, unit and meaning."""

    key: str
    value: Any
    unit: str
    meaning: str


@cache
def parameters() -> Mapping[str, ConfigKey]:
    """Return the description of each key of an experiment except ``[realtime]``, by its dotted name."""
    return {key: parameter for key, parameter in parameters_of(Experiment).items() if key != "realtime"}


@cache
def parameters_of(root: type) -> Mapping[str, ConfigKey]:
    """Return the description of each key of the dataclass `root`, by the key's dotted name.

    The name ``condition[].name`` is the key `name` in a list of tables `condition`.
    """
    return {parameter.key: parameter for parameter in _walk(root, "")}


def sections() -> Mapping[str, tuple[str, ...]]:
    """Return the names of the keys in each section of an experiment file, by its dotted name ("": top level)."""
    return sections_of(Experiment, ("preset",))


@cache
def sections_of(root: type, also: tuple[str, ...] = ()) -> Mapping[str, tuple[str, ...]]:
    """Return the keys of each section (TOML table) of a file with the fields of `root`, by the section's dotted name.

    `also` are further keys at the top level.
    """
    found: dict[str, tuple[str, ...]] = {"": (*also, *(f.name for f in fields(root)))}
    for key in parameters_of(root):
        while "." in key:
            key, _, leaf = key.rpartition(".")  # noqa: PLW2901
            leaf = leaf.removesuffix("[]")
            if leaf not in found.get(key, ()):
                found[key] = (*found.get(key, ()), leaf)
    return found


def _walk(section: type, prefix: str) -> Iterator[ConfigKey]:
    hints = get_type_hints(section, include_extras=True)
    for item in fields(section):
        hint, key = hints[item.name], prefix + item.name
        inner = _sole(hint)
        if is_dataclass(inner):
            yield from _walk(cast("type", inner), f"{key}.")
        elif get_origin(inner) is tuple and is_dataclass(get_args(inner)[0]):
            yield from _walk(get_args(inner)[0], f"{key}[].")
        else:
            yield _parameter(section, key, hint)


def _sole(hint: Any) -> Any:
    """Return the type of a field without its annotation, and of an optional field the type without None."""
    if get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    if get_origin(hint) is UnionType:
        return next(arm for arm in get_args(hint) if arm is not NoneType)
    return hint


def _parameter(section: type, key: str, hint: Any) -> ConfigKey:
    if get_origin(hint) is not Annotated:
        raise TypeError(
            f"{section.__name__}: field {key} has no unit and meaning; annotate it with a Quantity"
        )
    _, *metadata = get_args(hint)
    kind = _sole(hint)
    quantity = next(m for m in metadata if isinstance(m, Quantity))
    bounds = [
        f"{sign} {getattr(m, type(m).__name__.lower()):g}"
        for m in metadata
        for bound, sign in _BOUNDS
        if isinstance(m, bound)
    ]
    bounds += ["not empty" for m in metadata if isinstance(m, MinLen)]
    is_choice = get_origin(kind) is Literal
    name, values = "choice" if is_choice else _TYPES.get(kind, "table"), ""
    if get_origin(kind) is tuple:
        name = f"list of {_TYPES[get_args(kind)[0]]}"
    elif name == "table":
        values = _in_words(get_args(kind)[1])
    choices = get_args(kind) if is_choice else ()
    return ConfigKey(key, section, name, choices, tuple(bounds), quantity.unit, quantity.meaning, values)


def _in_words(values: Any) -> str:
    """Return which types of values a table may contain, as text such as "a finite number or text"."""
    arms = get_args(values) if get_origin(values) is UnionType else (values,)
    words = [
        word
        for word, kinds in (("a finite number", (int, float)), ("text", (str,)), ("true or false", (bool,)))
        if any(kind in arms for kind in kinds)
    ]
    last = (", or " if len(words) > 2 else " or ").join(words[-2:])
    return ", ".join([*words[:-2], last])


def describe(experiment: Experiment, under: str = "") -> tuple[ListedKey, ...]:
    """Return one line for each key of an experiment: key, value, unit (for the rig's motion) and meaning.

    Parameters
    ----------
    experiment
        Experiment whose keys are listed.
    under
        List only this section, like ``wall`` or ``rig.limits``; empty: all keys.
    """
    motion = experiment.rig.motion
    lines: list[ListedKey] = []
    for key, parameter in parameters().items():
        value = attrgetter(key)(experiment)
        if parameter.kind == "table":
            owner = experiment.controller.estimator if key == "controller.parameters" else "the board"
            lines += [
                ListedKey(f"{key}.{name}", v, _suffix_unit(name), f"setting of {owner}")
                for name, v in value.items()
            ]
        else:
            lines.append(ListedKey(key, value, parameter.unit_for(motion), parameter.meaning))
    return tuple(line for line in lines if not under or f"{line.key}.".startswith(f"{under}."))


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of an experiment file, for editors that complete and check TOML (taplo, VS Code).

    The schema requires no key, because a file may start from a preset.
    """
    schema = schema_of(Experiment)
    for definition in (schema, *schema["$defs"].values()):
        definition.pop("required", None)
    schema["properties"]["preset"] = {
        "enum": list(preset_names()),
        "description": "preset from which this file starts",
    }
    schema["properties"]["realtime"] = {"type": "object", "description": "changes for a loop in real time"}
    return schema


def schema_of(root: type) -> dict[str, Any]:
    """Return the JSON schema of a dataclass, in which each key has its meaning and unit as description."""
    schema: dict[str, Any] = pydantic.TypeAdapter(root).json_schema() | {"description": inspect.getdoc(root)}
    definitions: dict[str, Any] = schema["$defs"]
    for parameter in parameters_of(root).values():
        owner = schema if parameter.section is root else definitions[parameter.section.__name__]
        entry = owner["properties"][parameter.key.rpartition(".")[2]]
        unit = parameter.unit_for(None)
        entry["description"] = f"{parameter.meaning} [{unit}]" if unit else parameter.meaning
    return schema


def shown(value: Any) -> str:
    """Return a value as one short line of text, written as in a TOML file."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\n", "\\n")[:60] + '"'
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(shown, value[:5]))}{', …' if len(value) > 5 else ''}]"[:60]
    if isinstance(value, int) and value.bit_length() > 64:
        return "a number of more than 64 bits"
    return repr(value)[:60]


def _suffix_unit(name: str) -> str:
    return {"hz": "Hz", "s": "s", "a": "A", "counts": "count"}.get(name.rpartition("_")[2], "")
