"""From a file, a mapping or the command line to a checked `Experiment`, or to one error that lists all."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.config.files import Table, flatten, nest, overlay, preset_names, preset_table, read_toml, tidy
from rig.config.problems import Problem, config_error, did_you_mean
from rig.config.rules import broken_rules
from rig.config.sections import Experiment
from rig.config.table import parameters, sections, shown
from rig.errors import ConfigError
from rig.operators import GRIPS
from rig.sample import UNITS, Motion

if TYPE_CHECKING:
    from pydantic import TypeAdapter
    from pydantic_core import ErrorDetails

DEFAULT_PRESET = "koul-compliant"
DEFAULT_GRIP = "normal"
LOOP = "controller.loop"
FREE = "controller.parameters"  # the one table whose keys belong to somebody else: the estimator

_WRITE = {
    "number": "write a number, without quotes",
    "whole number": "write a whole number, without quotes",
    "true or false": "write true or false, without quotes",
    "text": "write text in quotes",
    "choice": "choose one of these, written exactly so",
}


def load_experiment(path: str | Path) -> Experiment:
    """Read and check an experiment file.

    The file may begin with ``preset = "koul-compliant"`` and then says only what differs.

    Raises
    ------
    ConfigError
        With every problem found, one per line: file, key, value, allowed range with its unit, and what to do.
    """
    return experiment_from_mapping(read_toml(Path(path)), str(path))


def experiment_from_mapping(mapping: Mapping[str, Any], source: str) -> Experiment:
    """Check nested tables like those of an experiment file; `source` is what errors call them."""
    table = tidy(mapping)
    if not isinstance(table, dict):
        raise ConfigError(
            f"{source}: not a table of sections", remedy="give tables like those of an experiment file"
        )
    if "preset" in table:
        name = table.pop("preset")
        table = _stack(_preset(name, source), table)
        source = f"{source} (on preset {name})"
    return _validated(table, source)


def override(experiment: Experiment, changes: Mapping[str, Any], source: str = "command line") -> Experiment:
    """Return the experiment with some keys changed, checked like a file.

    Parameters
    ----------
    experiment
        What to start from.
    changes
        New values by dotted key, like ``{"wall.stiffness": 400.0}``.
    source
        What errors call the changes.
    """
    return _validated(_stack(as_mapping(experiment), nest(tidy(changes))), source)


def realtime_changes(experiment: Experiment, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return what ``[realtime]`` changes, and over it what the user sets by hand, by dotted key.

    A law that the device runs needs nothing gentler: of ``[realtime]`` only what is about this computer is left then.
    """
    gentler: dict[str, Any] = dict(experiment.realtime)
    if changes.get(LOOP, experiment.controller.loop) == "device":
        gentler = {key: value for key, value in gentler.items() if key.startswith("host.")}
    return {**gentler, **changes}


def with_realtime(experiment: Experiment, changes: Mapping[str, Any] | None = None) -> Experiment:
    """Return the experiment as it runs in real time, checked; see `realtime_changes`."""
    wanted = realtime_changes(experiment, changes or {})
    return override(experiment, wanted, f"[realtime] of {experiment.rig.name}")


def as_mapping(experiment: Experiment) -> dict[str, Any]:
    """Return plain nested dicts for JSON; `experiment_from_mapping` makes an equal experiment of them."""
    return _plain(experiment)  # type: ignore[no-any-return]


def _preset(name: Any, source: str) -> Table:
    if not isinstance(name, str) or name not in preset_names():
        choice = f"choose one of: {', '.join(preset_names())}"
        raise config_error(
            [
                Problem(
                    "preset", shown(name), "is not a preset", did_you_mean(str(name), preset_names(), choice)
                )
            ],
            source,
        )
    return preset_table(name)


def _stack(base: Table, top: Table) -> Table:
    """Lay one experiment over another; their ``[realtime]`` tables are flattened first, so that keys meet.

    A key that the upper one sets is meant in real time too: it takes the lower one's ``[realtime]`` value away.
    """
    merged = overlay(base, top)
    layers = [layer["realtime"] for layer in (base, top) if "realtime" in layer]
    if layers and all(isinstance(layer, dict) for layer in layers):
        meant = {key for key, _ in flatten({name: part for name, part in top.items() if name != "realtime"})}
        below = base.get("realtime", {})
        kept = {key: value for key, value in flatten(below) if key not in meant}
        merged["realtime"] = {**kept, **dict(flatten(top.get("realtime", {})))}
    return merged


def _validated(table: Table, source: str) -> Experiment:
    table = _with_defaults(table)
    try:
        experiment, problems = _typed(table)
        problems += _wrong_realtime(table.get("realtime", {}))
        if experiment is not None and not problems:
            problems = broken_rules(experiment)
    except ArithmeticError as error:
        raise ConfigError(
            f"{source}: some values are too large or too small to compute with ({error})",
            remedy="check units and powers of ten",
        ) from None
    if problems or experiment is None:
        raise config_error(problems, source)
    return experiment


def _with_defaults(table: Table) -> Table:
    """Fill in what follows from other keys.

    The effort limit is the nominal effort, safe for people; the numbers of an operator are those of its grip.
    """
    limits = _value_at(table, ("rig", "limits"))
    if isinstance(limits, dict) and "nominal_effort" in limits and "effort" not in limits:
        table = overlay(table, nest({"rig.limits.effort": limits["nominal_effort"]}))
    operator = table.get("operator")
    if isinstance(operator, dict):
        grip = operator.get("grip", DEFAULT_GRIP)
        known = GRIPS.get(grip) if isinstance(grip, str) else None
        table = {**table, "operator": {**_plain(known or GRIPS[DEFAULT_GRIP]), **operator}}
    if isinstance(table.get("realtime"), dict):
        table = {**table, "realtime": dict(flatten(table["realtime"]))}
    return table


def _typed(table: Table) -> tuple[Experiment | None, list[Problem]]:
    """Check every key and value by itself."""
    from pydantic import ValidationError  # noqa: PLC0415  (slow to import, and only needed here)

    problems = list(_mistaken_choices(table))
    # By way of JSON, because strict validation of Python objects accepts instances of the dataclasses only.
    text = json.dumps(_jsonable(table))
    try:
        experiment = _adapter().validate_json(text)
    except ValidationError as error:
        motion = _motion(table)
        found = [_problem_of(e, table, motion) for e in error.errors(include_url=False)]
        return None, list(dict.fromkeys(found)) + problems
    return experiment, problems


@cache
def _adapter() -> TypeAdapter[Experiment]:
    from pydantic import TypeAdapter  # noqa: PLC0415

    return TypeAdapter(Experiment)


def _jsonable(value: Any) -> Any:
    """Replace what JSON has no word for by what no key accepts."""
    if isinstance(value, dict):
        return {key: _jsonable(inner) for key, inner in value.items()}
    if isinstance(value, int) and value.bit_length() > 1024:  # no float is that large
        return math.inf
    return value if value is None or isinstance(value, bool | int | float | str) else []


def _problem_of(error: ErrorDetails, table: Table, motion: Motion | None) -> Problem:
    """Say in our words what pydantic found at a place."""
    path = [str(part) for part in error["loc"]]
    if path[:1] == ["realtime"]:
        path = path[:2]  # what follows names an arm of the union
    if path[:2] == FREE.split("."):
        path = path[:3]
    key, section, leaf = ".".join(path), ".".join(path[:-1]), path[-1] if path else ""
    value = _value_at(table, path)
    if error["type"] == "unexpected_keyword_argument":
        return Problem(key, "", "is not a known key", _known_instead(section, leaf))
    parameter = parameters().get(key)
    if section in (FREE, "realtime"):
        must = (
            "must be a finite number or text"
            if section == FREE
            else "must be a finite number, text, or true or false"
        )
        return Problem(key, shown(value), must, "write one of these")
    if parameter is None or parameter.kind == "table":
        return _wrong_section(error, key, value)
    must = f"{parameter.expected(motion)} ({parameter.meaning})"
    if error["type"] == "missing":
        remedy = f"add {leaf} under [{section}], or start from a preset with preset = {shown(DEFAULT_PRESET)}"
        return Problem(key, "", f"is missing: {must}", remedy)
    return Problem(key, shown(value), f"must be {must}", _better(value, parameter.kind, parameter.choices))


def _wrong_section(error: ErrorDetails, key: str, value: Any) -> Problem:
    name = f"[{key}]" if key else "the experiment"
    contents = ", ".join(sections().get(key, ())) or "numbers by name"
    if error["type"] == "missing":
        remedy = f"add it, or start from a preset with preset = {shown(DEFAULT_PRESET)}"
        return Problem(name, "", f"is missing: a table with {contents}", remedy)
    if error["type"] == "value_error":  # a dataclass that checks its own keys against each other
        message = str(error["ctx"]["error"])
        found = ", ".join(f"{k} = {shown(v)}" for k, v in value.items() if k in message) or "none of them"
        return Problem(name, "", f"{message} (given: {found})", "change these keys together")
    remedy = f"write {name} and its keys below it"
    return Problem(key, shown(value), f"must be a table with {contents}", remedy)


def _known_instead(section: str, leaf: str) -> str:
    """Suggest what an unknown key may have meant: the nearest of its section, or the same name elsewhere."""
    siblings = sections().get(section, ())
    elsewhere = [key for key in parameters() if key.rpartition(".")[2] == leaf]
    otherwise = (
        f"did you mean {' or '.join(elsewhere)}?" if elsewhere else f"known here: {', '.join(siblings)}"
    )
    return did_you_mean(leaf, siblings, otherwise)


def _better(value: Any, kind: str, choices: Iterable[int | str]) -> str:
    """Say how to write a value right."""
    if kind == "choice" and isinstance(value, str):
        return did_you_mean(value, [c for c in choices if isinstance(c, str)], "choose one of these")
    if kind == "whole number" and isinstance(value, float) and value.is_integer():
        return f"write {int(value)}, without a decimal point"
    if "number" in kind and isinstance(value, int | float) and not isinstance(value, bool):
        return "choose a value in this range"
    return _WRITE[kind]


def _mistaken_choices(table: Table) -> Iterator[Problem]:
    """Find true or 1.0 where a choice is the whole number 1: equal in Python, but not in a file."""
    for key, parameter in parameters().items():
        value = _value_at(table, key.split("."))
        if isinstance(value, bool | float) and value in parameter.choices:
            must = f"must be {parameter.expected(None)} ({parameter.meaning})"
            yield Problem(key, shown(value), must, _better(value, "choice", ()))


def _wrong_realtime(changes: Any) -> Iterator[Problem]:
    """Find keys of ``[realtime]`` that name nothing; their values are checked when they are applied."""
    for key, value in changes.items() if isinstance(changes, dict) else ():
        section, _, leaf = key.rpartition(".")
        if key not in parameters() and section != FREE:
            yield Problem(
                f"realtime.{key}", shown(value), "is not a known key", _known_instead(section, leaf)
            )


def _value_at(table: Table, path: Iterable[str]) -> Any:
    value: Any = table
    for part in path:
        value = value.get(part) if isinstance(value, dict) else None
    return value


def _motion(table: Table) -> Motion | None:
    named = _value_at(table, ("rig", "motion"))
    return named if isinstance(named, str) and named in UNITS["position"] else None  # type: ignore[return-value]


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        inner = ((item.name, getattr(value, item.name)) for item in fields(value))
        return {name: _plain(v) for name, v in inner if v is not None}
    return dict(value) if isinstance(value, Mapping) else value
