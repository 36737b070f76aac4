"""Read experiment files and presets (TOML) as nested dicts, and overlay one dict on another.

A *table* is a section of a TOML file, and the dict that represents it. The loaders of experiments, protocols and boards
use it. It must not check a key.
"""

import re
import tomllib
import unicodedata
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from rig.config._problems import did_you_mean
from rig.core.errors import ConfigError
from rig.core.regular_file import read_regular

Table = dict[str, Any]
# Types of most values in a file: a lookup of the type suffices to recognise them.
LEAVES = {type(None), bool, int, float, str}
# Quoted text and comments, in which any character is allowed.
_QUOTED = re.compile(r"""\"[^"]*\"|'[^']*'|#.*""")
# No section is nested deeper; a deeper table is refused by name instead of by a stack overflow.
DEPTH = 8


def read_toml(path: Path, kind: str = "an experiment") -> Table:
    """Return the content of a TOML file as nested dicts; raise `ConfigError` if it is missing, unreadable or not TOML.

    `kind` names the kind of file in messages, such as "an experiment".
    """
    try:
        text = read_regular(path).decode("utf-8-sig")
    except FileNotFoundError:
        nearby = [p.name for p in path.parent.glob("*.toml")] if path.parent.is_dir() else []
        remedy = did_you_mean(path.name, nearby, f"give the path of {kind} file")
        raise ConfigError(f"{path}: no such file", remedy=remedy) from None
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path}: not UTF-8 text (at byte {error.start})", remedy="save it as UTF-8"
        ) from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(
            f"{path}: cannot be read: {reason}", remedy="give the path of a readable text file"
        ) from None
    return parse_toml(text, str(path))


def parse_toml(text: str, source: str) -> Table:
    """Return TOML text as nested dicts; raise `ConfigError` for a syntax error. `source` names the text in messages."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        reason = str(error) if isinstance(error, ValueError) else "the tables are nested too deeply"
        characters = _misleading(text, reason)
        raise ConfigError(
            f"{source}: not valid TOML: {reason}{characters and f'; that line contains {characters}'}",
            remedy="retype these characters, or put them in quotes"
            if characters
            else "correct the file at this line and column",
        ) from None


def _misleading(text: str, reason: str) -> str:
    """Return the names of invisible or non-ASCII characters outside quotes in the line of a syntax error, or "".

    `reason` is the message of the TOML parser, which contains the line number.
    """
    place = re.search(r"at line (\d+)", reason)
    if place is None:
        return ""
    line = _QUOTED.sub("", text.split("\n")[int(place[1]) - 1].removesuffix("\r"))
    found = dict.fromkeys(one for one in line if one != "\t" and not (one.isascii() and one.isprintable()))
    return ", ".join(f"U+{ord(one):04X} {unicodedata.name(one, 'control character')}" for one in found)


@cache
def preset_names() -> tuple[str, ...]:
    """Return the sorted names of the presets (built-in experiment files)."""
    found = (files("rig.config") / "presets").iterdir()
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in found if entry.name.endswith(".toml")))


def preset_text(name: str) -> str:
    """Return the TOML text of a preset (built-in experiment file); raise `ConfigError` for an unknown name."""
    if name not in preset_names():
        choice = f"choose one of: {', '.join(preset_names())}"
        raise ConfigError(f"unknown preset {name!r}", remedy=did_you_mean(name, preset_names(), choice))
    return (files("rig.config") / "presets" / f"{name}.toml").read_text(encoding="utf-8")


@cache
def preset_table(name: str) -> Table:
    """Return a preset as nested dicts, parsed once; callers share the result and must not change it."""
    return parse_toml(preset_text(name), f"preset {name}")


def tidy(value: Any, depth: int = 0) -> Any:
    """Return nested mappings and sequences as dicts and lists, cut off below `DEPTH` levels; other values unchanged."""
    if type(value) in LEAVES or not isinstance(value, Mapping | list | tuple):
        return value
    if depth == DEPTH:
        return f"a table nested deeper than {DEPTH} levels"
    if isinstance(value, list | tuple):
        return [tidy(inner, depth + 1) for inner in value]
    return {str(key): tidy(inner, depth + 1) for key, inner in value.items()}


def overlay(base: Table, top: Table) -> Table:
    """Return a copy of `base` in which the keys of `top` are replaced or added, also inside nested tables.

    If `top` names another velocity estimator, or another grip of the simulated hand, than `base`, the settings in
    `base` that belong to the old one are dropped.
    """
    merged = dict(base)
    for key, value in top.items():
        below = merged.get(key)
        merged[key] = overlay(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    if "estimator" in top and "estimator" in base and top["estimator"] != base["estimator"]:
        merged["parameters"] = top.get("parameters", {})
    if "grip" in top and "grip" in base and top["grip"] != base["grip"]:
        return dict(top)
    return merged


def flatten(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted key and value of each entry in nested tables; an empty table is yielded as a value."""
    for key, value in table.items():
        if isinstance(value, dict) and value:
            yield from flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def nest(flat: Mapping[str, Any]) -> Table:
    """Return nested tables from a mapping of dotted keys to values: the inverse of `flatten`."""
    root: Table = {}
    for dotted, value in flat.items():
        *path, leaf = dotted.split(".")
        node = root
        for part in path:
            below = node.get(part)
            node[part] = node = below if isinstance(below, dict) else {}
        node[leaf] = (
            overlay(node[leaf], value)
            if isinstance(value, dict) and isinstance(node.get(leaf), dict)
            else value
        )
    return root
