"""Describe a message's field (C type, unit, meaning) in its type annotation, and convert such fields to bytes.

`firmware_protocol.messages` annotates fields with it; packing and code generator read them. It must not depend on a
message.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from typing import Any, get_type_hints

FORMATS = {
    "u8": "B",
    "i8": "b",
    "u16": "H",
    "i16": "h",
    "u32": "I",
    "i32": "i",
    "u64": "Q",
    "i64": "q",
    "f32": "f",
}


@dataclass(frozen=True, slots=True)
class Wire:
    """Description of a message's field: C type (``u16``, …; "bytes" is the rest of the frame), unit and meaning."""

    ctype: str
    unit: str
    meaning: str


def wire_fields(cls: type) -> dict[str, Wire]:
    """Return the `Wire` (C type, unit, meaning) of each field of a message class by name, in order of the bytes."""
    return _wire_fields(cls)


@cache  # apart from its caller, whose types mypy finds not hashable
def _wire_fields(cls: type) -> dict[str, Wire]:
    return {name: hint.__metadata__[0] for name, hint in get_type_hints(cls, include_extras=True).items()}


def fixed_fields(cls: type) -> dict[str, Wire]:
    """Return the `Wire` (C type, unit, meaning) of each field of a class by name, except fields of variable length."""
    return {name: wire for name, wire in wire_fields(cls).items() if wire.ctype != "bytes"}


def record_struct(cls: type) -> struct.Struct:
    """Return the `struct.Struct` of all fields of a class with a fixed length: little-endian, without padding."""
    return struct.Struct("<" + "".join(FORMATS[wire.ctype] for wire in fixed_fields(cls).values()))


def field_getter(cls: type) -> Callable[[Any], tuple[int, ...]]:
    """Return a function that reads the fields of fixed length from an instance of `cls` and returns them as a tuple."""
    names = list(fixed_fields(cls))
    getter: Callable[[Any], Any] = attrgetter(*names)
    if len(names) > 1:
        return getter
    return lambda record: (getter(record),)  # attrgetter of one name gives a bare value
