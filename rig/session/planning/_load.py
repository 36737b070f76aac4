"""Read a protocol file or mapping and return a checked `Protocol`, or raise one error that lists all problems.

Sessions, checks and logs use it. It must not open a device.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.config import presets, schema_of
from rig.config.checked import FileKind, Problem, config_error, flatten, parse_table, plain, read_toml, tidy
from rig.core.errors import ConfigError
from rig.core.sample import Motion
from rig.session.planning._conditions import ReachFor, Walls, base_experiment, broken_conditions
from rig.session.planning._names import normalise
from rig.session.planning._protocol import Protocol
from rig.session.planning._rules import broken_rules, looks_like_a_name, settings_schema, spells_a_name

PROTOCOL = FileKind(
    Protocol, "the protocol", otherwise="start from a template: rig session new --template compare-schemes"
)
DIALECT = "https://json-schema.org/draft/2020-12/schema"
LONGEST_CODE = 32  # characters of a code, which becomes the name of a directory
_NAMES = {  # keys whose values are compared as names, by section
    "study": ("title",),
    "condition": ("name", "fit"),
    "practice": ("condition",),
    "question": ("name", "choices"),
}


def load_protocol(path: str | Path) -> Protocol:
    """Return the protocol from a file; raise `ConfigError` if it, its experiment or a condition is invalid."""
    return load_walls(path).protocol


def load_walls(path: str | Path, reach_for: ReachFor | None = None) -> Walls:
    """Read and check a protocol file; return the protocol with an experiment for each wall that it may present.

    `reach_for` is needed only for a simulated hand: it computes how long the hand moves to the wall. Raise
    `ConfigError` if the file is not valid, with one line for each problem: file, key, value, allowed range, remedy.
    """
    path, source = Path(path), str(path)
    table = tidy(read_toml(path, "a protocol"))
    base = base_experiment(table.get("study"), path.parent)
    motion = None if isinstance(base, list) else base.rig.motion
    protocol, problems = _check_table(table, motion)
    if isinstance(base, list):
        known = {problem.key for problem in problems}
        problems += [problem for problem in base if problem.key not in known]
    if problems or protocol is None or isinstance(base, list):
        raise config_error(problems, source)
    walls = Walls(protocol, base, reach_for)
    broken = broken_conditions(walls)
    if broken:
        raise config_error(broken, source)
    return walls


def protocol_from_mapping(mapping: Mapping[str, Any], source: str) -> Protocol:
    """Return the checked protocol from nested dictionaries; error messages call them `source`.

    The experiment that the protocol names is not read, so that a log can be read without the experiment's file. Raise
    `ConfigError` if the dictionaries are not a valid protocol.
    """
    table = tidy(mapping)
    if not isinstance(table, dict):
        raise ConfigError(
            f"{source} is not a protocol: the top level must be a table with sections like [study] and [search]",
            remedy="start from a file that `rig session new` writes",
        )
    protocol, problems = _check_table(table, None)
    if problems or protocol is None:
        raise config_error(problems, source)
    return protocol


def as_mapping(protocol: Protocol) -> dict[str, Any]:
    """Return the protocol as nested dictionaries for JSON; `protocol_from_mapping` converts them back."""
    return plain(protocol)  # type: ignore[no-any-return]


def check_code(protocol: Protocol, code: str) -> None:
    """Raise `ConfigError` if a participant's code does not match the protocol's pattern, or looks like a name."""
    pattern = protocol.study.code
    if "@" in code:
        why = "is an e-mail address, which identifies a person"
    elif any(mark in code for mark in "/\\") or code in (".", "..") or code.startswith("."):
        why = "contains parts of a path, but it must be usable as a directory name"
    elif any(character.isspace() or not character.isprintable() for character in code):
        why = "contains spaces or control characters, like a name"
    elif not code or len(code) > LONGEST_CODE:
        why = f"must have 1 to {LONGEST_CODE} characters"
    elif looks_like_a_name(code):
        why = "looks like a name; sessions must not store names"
    elif re.fullmatch(pattern, code) is None:
        why = f"does not match the study's pattern {pattern}"
    elif spells_a_name(code, pattern):
        why = "looks like a name: three or more freely chosen letters in a row; sessions must not store names"
    else:
        return
    raise ConfigError(
        f"participant code {code[:60]!r} {why}",
        remedy=f"give the code assigned to this person in the study's list; it must match {pattern}",
    )


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a protocol file, for editors that complete and check TOML (taplo, VS Code)."""
    schema = {"$schema": DIALECT, **schema_of(Protocol)}
    _type_settings(schema["$defs"]["Search"])
    schema["$defs"]["Study"]["properties"]["preset"]["examples"] = list(presets.names())
    # Keys of an experiment may be dotted with or without quotes in TOML, so the schema allows any table.
    for owner in ("Study", "Condition"):
        changes = schema["$defs"][owner]["properties"]["changes"]
        schema["$defs"][owner]["properties"]["changes"] = {
            "type": "object",
            "description": changes["description"],
        }
    return _without_null(schema)  # type: ignore[no-any-return]


def _without_null(schema: Any) -> Any:
    # TOML has no null: an optional key is left out instead.
    if isinstance(schema, list):
        return [_without_null(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {key: _without_null(one) for key, one in schema.items() if (key, one) != ("default", None)}
    choices = [one for one in kept.get("anyOf", []) if one != {"type": "null"}]
    if len(choices) == 1:
        del kept["anyOf"]
        kept = {**choices[0], **kept}
    return kept


def _type_settings(search: dict[str, Any]) -> None:
    names, default = search["properties"]["rule"]["enum"], search["properties"]["rule"]["default"]
    search["allOf"] = [
        {
            "if": {
                "properties": {"rule": {"const": name}},
                **({} if name == default else {"required": ["rule"]}),
            },
            "then": {"properties": {"settings": settings_schema(name)}},
        }
        for name in names
    ]


def _check_table(table: dict[str, Any], motion: Motion | None) -> tuple[Protocol | None, list[Problem]]:
    table = _with_names(_flat_changes(table))
    try:
        parsed = parse_table(PROTOCOL, table, motion)
        protocol, problems = parsed
        if protocol is not None and not problems:
            problems = broken_rules(protocol)
    except ArithmeticError as error:
        return None, [
            Problem(
                "the protocol",
                "",
                f"has values too large or too small to compute with ({error})",
                "check units and powers of ten",
            )
        ]
    return protocol, problems


def _flat_changes(table: dict[str, Any]) -> dict[str, Any]:
    """Return the table with all changes by dotted key; in the file they may be quoted dotted keys or nested tables."""

    def flat(section: Any) -> Any:
        if isinstance(section, dict) and isinstance(section.get("changes"), dict):
            return {**section, "changes": dict(flatten(section["changes"]))}
        return section

    conditions = table.get("condition")
    return table | {
        key: value
        for key, value in (
            ("study", flat(table.get("study"))),
            ("condition", list(map(flat, conditions)) if isinstance(conditions, list) else None),
        )
        if value is not None
    }


def _with_names(table: dict[str, Any]) -> dict[str, Any]:

    def spelt(value: Any) -> Any:
        if isinstance(value, list):
            return [spelt(one) for one in value]
        return normalise(value) if isinstance(value, str) else value

    def section(value: Any, keys: tuple[str, ...]) -> Any:
        if isinstance(value, list):
            return [section(one, keys) for one in value]
        if not isinstance(value, dict):
            return value
        return {key: spelt(one) if key in keys else one for key, one in value.items()}

    return {name: section(value, _NAMES.get(name, ())) for name, value in table.items()}
