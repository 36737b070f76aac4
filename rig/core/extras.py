"""Find the commands, URL schemes and other parts that extras (optional packages) add, by listing ``rig/extras``.

An extra is a package in that folder with a ``table.json``: its commands, URL schemes and so on by their names, each
with a target ``module:attribute`` that is imported on use. A package of `rig` can have such a table for lower packages.
Packages that can be extended look names up here; this file must not import an extra, or contain the name of one.

An extra whose table cannot be read is broken: a name that it may have added is refused with the reason, and nothing of
the core or of another package takes its place.
"""

import json
import os
from collections.abc import Iterator, Mapping
from functools import cache
from pkgutil import resolve_name
from typing import Any, NamedTuple

from rig.core.errors import ConfigError, RigError

ROOMS = os.path.dirname(os.path.dirname(__file__))  # pathlib takes longer to import than this to read
TABLE = "table.json"  # data, not code: no extra can delay or end a command that does not use it
KINDS = {
    "commands": "command",
    "schemes": "URL scheme",
    "executors": "executor of sweeps",
    "arithmetics": "arithmetic of a law on the device",
    "marks": "stream of a session's marks",
    "pictures": "picture of",
    "writers": "writer of pictures",
}
_REMEDY = "install haptic-rig again"


class ExtraRow(NamedTuple):
    """One part (command, URL scheme, …) that an extra (optional package) adds: name, import target, further keys."""

    name: str
    target: str
    extra: str
    more: Mapping[str, Any]


class ExtraTable(NamedTuple):
    """Parts (commands, URL schemes, …) that an optional package adds; `broken` says why they cannot be read."""

    owner: str
    folder: str
    rows: Mapping[str, Mapping[str, ExtraRow]] = {}
    broken: str = ""


@cache
def tables() -> tuple[ExtraTable, ...]:
    """Return the tables of the parts (commands, URL schemes, …) that packages and extras add, broken ones too."""
    found: list[ExtraTable] = []
    for folder in _folders():
        table = _read(folder)
        twice = [
            f"{other.owner} has the {KINDS[kind]} {name!r}, too"
            for other in found
            for kind, rows in table.rows.items()
            for name in rows
            if name in other.rows.get(kind, ())
        ]
        found.append(ExtraTable(table.owner, folder, broken=twice[0]) if twice else table)
    return tuple(found)


def added(kind: str) -> dict[str, ExtraRow]:
    """Return all parts of one `kind` (such as "commands", a key of `KINDS`) that optional packages add, by name."""
    return {name: row for table in tables() for name, row in table.rows.get(kind, {}).items()}


def broken() -> dict[str, str]:
    """Return the reason, by name, for each extra (optional package) whose table of parts cannot be read."""
    return {table.owner: table.broken for table in tables() if table.broken}


def find(kind: str, name: str, extra: str = "") -> ExtraRow:
    """Return the part (command, URL scheme, …) with this name; raise `ConfigError` if no optional package adds it.

    `kind` is a key of `KINDS`, such as "commands"; `extra` is the package to name in the message, if it is known.
    """
    rows = added(kind)
    if name in rows:
        return rows[name]
    reasons = {owner: why for owner, why in broken().items() if extra in ("", owner)}
    problem = "; ".join(f"the extra {owner} is broken: {why}" for owner, why in reasons.items())
    missing = "no installed extra has it" + (f", it belongs to the extra {extra}" if extra else "")
    raise ConfigError(f"cannot find the {KINDS[kind]} {name}: {problem or missing}", remedy=_REMEDY)


def load(kind: str, name: str) -> Any:
    """Import and return the object that an extra adds under a name; raise `ConfigError` if it is missing or fails."""
    row = find(kind, name)
    try:
        return resolve_name(row.target)
    except RigError:  # the extra itself reports what it needs
        raise
    except Exception as error:
        raise ConfigError(
            f"{KINDS[kind]} {name}: cannot import {row.target} of the extra {row.extra}: {error}",
            remedy=_REMEDY,
        ) from error


def _folders() -> Iterator[str]:
    of_extras = os.path.join(ROOMS, "extras")
    for place in (ROOMS, of_extras):
        for name in sorted(os.listdir(place)) if os.path.isdir(place) else []:
            folder = os.path.join(place, name)
            package = place == of_extras and os.path.exists(os.path.join(folder, "__init__.py"))
            if package or os.path.exists(os.path.join(folder, TABLE)):
                yield folder


def _read(folder: str) -> ExtraTable:
    owner, path = os.path.basename(folder), os.path.join(folder, TABLE)
    if not os.path.isfile(path):  # nor is a pipe opened, which would wait for a writer
        return ExtraTable(owner, folder, broken=f"{path} is missing")
    try:
        with open(path, encoding="utf-8") as file:
            content = json.load(file)
        return ExtraTable(
            owner, folder, {kind: _parse_rows(kind, rows, owner) for kind, rows in content.items()}
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        return ExtraTable(owner, folder, broken=f"{path}: {error!r}")


def _parse_rows(kind: str, rows: Mapping[str, Any], owner: str) -> dict[str, ExtraRow]:
    if kind not in KINDS:
        raise ValueError(f"an extra cannot add parts of the kind {kind!r}; choose one of {', '.join(KINDS)}")
    found = {}
    for name, row in rows.items():
        more = dict(row)
        target = more.pop("target")
        if not isinstance(target, str) or ":" not in target:
            raise ValueError(f"part {name!r}: target {target!r} does not have the form module:attribute")
        found[name] = ExtraRow(name, target, owner, more)
    return found
