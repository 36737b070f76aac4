"""Check the section ``[keys]`` of a protocol, and find the meaning of a pressed key.

The check of a protocol, the terminal and the page use it. It must not read a key itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from rig.core.errors import ConfigError

if TYPE_CHECKING:
    from rig.session.planning._protocol import Keys

VERDICTS = ("stable", "buzz", "unstable", "unsure")
STOP, HELP = "space", "?"
RESERVED = {
    STOP: "this key is always STOP",
    "enter": "this key always means go",
    HELP: "this key lists the keys",
    "escape": "this key cancels text entry",
    "backspace": "this key edits text",
}

NAMED = frozenset(
    {
        "enter",
        "space",
        "tab",
        "escape",
        "backspace",
        "up",
        "down",
        "left",
        "right",
        "home",
        "end",
        "pageup",
        "pagedown",
        "insert",
        "delete",
    }
) | {f"f{n}" for n in range(1, 13)}


@dataclass(frozen=True, slots=True)
class KeyMap:
    """Assignment of keys to meanings (verdicts and actions): `keys` contains the key for each meaning.

    `bell` is True if the terminal rings when the participant may begin.
    """

    keys: Mapping[str, str]  # what it means → key
    bell: bool = True

    @classmethod
    def of(cls, keys: Keys) -> KeyMap:
        """Return the key map for the section ``[keys]``; raise `ConfigError` for an invalid or repeated key."""
        named = {field.name: getattr(keys, field.name) for field in fields(keys) if field.name != "bell"}
        return cls({meaning: _check_key(meaning, key, named) for meaning, key in named.items()}, keys.bell)

    @classmethod
    def from_mapping(cls, value: Mapping[str, Any]) -> KeyMap:
        """Return the key map from a dictionary with ``keys`` and ``bell``, as `rig.core.present.plain` writes it."""
        return cls(dict(value["keys"]), bool(value["bell"]))

    def meaning(self, key: str) -> str:
        """Return the meaning of a key, ignoring case: a verdict, an action, ``stop``, ``help``, or ""."""
        special = {STOP: "stop", HELP: "help", "enter": "go"}.get(key)
        if special:
            return special
        return next((meaning for meaning, known in self.keys.items() if known == key.lower()), "")

    def key_of(self, meaning: str) -> str:
        """Return the name of the key with this meaning, for display; "" if no key has it."""
        return self.keys.get(meaning, "")

    @property
    def verdicts(self) -> list[tuple[str, str]]:
        """Pairs of key and verdict, in the order of `VERDICTS`."""
        return [(self.keys[verdict], verdict) for verdict in VERDICTS]


def _check_key(meaning: str, written: str, all_keys: Mapping[str, str]) -> str:
    key = written.lower()
    if key == " ":
        key = STOP
    if key in RESERVED:
        raise ConfigError(
            f"[keys] {meaning} = {written!r} is a reserved key: {RESERVED[key]}", remedy="choose another key"
        )
    if not (len(key) == 1 and key.isprintable()) and key not in NAMED:
        raise ConfigError(
            f"[keys] {meaning} = {written!r} is not the name of a key",
            remedy=f"give one character, or one of {', '.join(sorted(NAMED - set(RESERVED)))}",
        )
    twin = next((other for other, its in all_keys.items() if its.lower() == key and other != meaning), None)
    if twin is not None:
        raise ConfigError(
            f"[keys] {meaning} = {written!r}: this key already means {twin}",
            remedy="give each meaning another key",
        )
    return key
