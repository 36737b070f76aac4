"""Required shape of the header and trailer of a recording, for code that reads numbers and names from them.

A checksum shows that a file was not changed by accident, not that this program wrote the file. Only keys that this
program reads are listed. `rig.config` checks the experiment, and a replay checks the controller's initial state.
"""

import json
from collections.abc import Iterator
from typing import Any

# Recordings need about half of this depth; the interpreter's stack allows some hundreds of levels.
DEPTH = 32
_GREATEST = 1 << 62
_NESTS = (dict, list)
_NUMBER = object()  # one that numpy can hold
HEADER: dict[str, Any] = {
    "rig": str,
    "motion": ("rotary", "linear"),
    "experiment": {"controller?": {"position_rate?": range(1, 10**7)}},
    "identity": {"device?": str, "url?": str, "current_quantum_a?": _NUMBER},
    "clocks": {"kind?": str},
    "extra": {
        "loop?": str,
        "arithmetic?": str,
        "wall?": {"*": _NUMBER},
        "cut?": {
            "recording": str,
            "sha256?": str,
            "first_tick": _NUMBER,
            "first_s": _NUMBER,
            "last_s": _NUMBER,
            "cut_at": str,
        },
        "counts?": {
            "file": str,
            "rate_hz": _NUMBER,
            "resolution": _NUMBER,
            "width?": _NUMBER,
            "lost_samples": _NUMBER,
            "gaps": _NUMBER,
            "longest_gap": _NUMBER,
            "deviation_max?": _NUMBER,
            "deviation_rms?": _NUMBER,
        },
    },
    "initial_state": {"control?": {"reference_count?": _NUMBER}},
    "schema": dict,
}
TRAILER: dict[str, Any] = {
    "reason?": str,
    "error?": str,
    "fault?": {"name": str},
    "counters?": {"*": _NUMBER},
    "parameter_sets?": [{"tick": _NUMBER, "wall_position": _NUMBER, "parameters": [_NUMBER]}],
    "device_host_agreement?": {"*": _NUMBER},
    "verdict?": {"kind?": str, "reasons?": [str]},
}


def parse_json(text: bytes) -> Any:
    """Parse JSON; raise `ValueError` if the text is not valid JSON, or is nested deeper than `DEPTH` levels."""
    try:
        value = json.loads(text)
    except RecursionError:
        raise ValueError(f"the JSON is nested deeper than {DEPTH} levels") from None
    level = [value]
    for _ in range(DEPTH):
        level = [below for one in level if type(one) in _NESTS for below in _parts(one)]
    if level:
        raise ValueError(f"the JSON is nested deeper than {DEPTH} levels")
    return value


def _parts(value: Any) -> Any:
    return value.values() if isinstance(value, dict) else value


def misfit(value: Any, shape: Any, name: str) -> str:
    """Return a sentence about the first part of `value` that does not match `shape`; "" if all parts match.

    `shape` is a tree of types, e.g. ``{"reason?": str}``. A key that ends in "?" may be missing or null; "*" matches
    every key. If `shape` is a tuple or a range, the value must be one of its members.
    """
    inside: list[tuple[Any, Any, str]] = []
    if isinstance(shape, list):
        fits = isinstance(value, list)
        inside = [(one, shape[0], f"{name}[{i}]") for i, one in enumerate(value)] if fits else []
    elif isinstance(shape, dict):
        fits = isinstance(value, dict)
        inside = list(_members(value, shape, name)) if fits else []
    # `value in range` would compare with every member if `value` is a float.
    elif isinstance(shape, range):
        fits = isinstance(value, int | float) and shape.start <= value < shape.stop and value == int(value)
    elif isinstance(shape, tuple):
        fits = value in shape
    elif shape is _NUMBER:
        fits = isinstance(value, int | float) and abs(value) < _GREATEST
    else:
        fits = isinstance(value, shape)
    if not fits:
        return f"{name} has the invalid value {repr(value)[:40]}"
    return next(filter(None, (misfit(*one) for one in inside)), "")


def _members(value: dict[str, Any], shape: dict[str, Any], name: str) -> Iterator[tuple[Any, Any, str]]:
    for key, inner in dict.fromkeys(value, shape["*"]).items() if "*" in shape else shape.items():
        known = key if "*" in shape else key.removesuffix("?")
        if known == key or value.get(known) is not None:
            yield value.get(known), inner, f"{name}.{known}"
