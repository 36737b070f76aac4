"""Requests of a page: JSON objects, converted to dataclasses.

`do` names the request; `number` is chosen by the page and repeated in the reply. Every field is checked by type and
range before anything is done; an unknown field is an error.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le, MaxLen

from rig.config import shown
from rig.core.deferred import pydantic
from rig.core.errors import ConfigError
from rig.core.quantity import STRICT
from rig.extras.console.trigger import Trigger
from rig.extras.console.view import DEFAULT

Name = Annotated[str, MaxLen(4096)]
Scalar = float | int | bool | str
Changes = Annotated[dict[Annotated[str, MaxLen(200)], Scalar], MaxLen(200)]
# A law is a program that runs on this computer, which a page must not choose.
RESERVED = ("wall.law",)
MOST_BYTES = 1 << 16  # largest message


@dataclass(frozen=True, kw_only=True, slots=True)
class Request:
    """Fields of every request: its name, and a number for the reply (0: no reply)."""

    do: Name
    number: Annotated[int, Ge(0), Le(2**53)] = 0

    __pydantic_config__ = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Operate(Request):
    """Request the right to operate the rig (`take`), or give it back; only one page operates at a time."""

    take: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Stop(Request):
    """Request zero effort of every control loop of this user; any page may send it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Run(Request):
    """Request a run on a rig (built-in name or file); with `is_detached` the run continues without a page."""

    job: Literal["hit", "play"]
    rig: Name = "koul-compliant"
    url: Name = "sim://"
    changes: Changes = field(default_factory=dict)
    duration_s: Annotated[float, Ge(1), Le(3600)] = 120.0
    is_detached: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Set(Request):
    """Request changes of the wall of the followed control loop, like the command `rig set`."""

    changes: Changes


@dataclass(frozen=True, kw_only=True, slots=True)
class Hand(Request):
    """Position to which the hand is dragged (rad or m, at the link), and the force with which it presses (N)."""

    position: float
    press: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Show(Request):
    """Set columns, window and trigger of the page's scope; while `paused` the scope receives no new samples."""

    columns: Annotated[tuple[Name, ...], MaxLen(100)] = DEFAULT
    window_s: float = 2.0
    trigger: Trigger | None = None
    paused: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Zoom(Request):
    """Request the stored samples of a time span (s since the loop's first row) in detail, for a paused scope."""

    columns: Annotated[tuple[Name, ...], MaxLen(100)] = DEFAULT
    first_s: float
    last_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Cut(Request):
    """Request that a time span of the followed control loop (s since its first row) is saved as a new recording."""

    first_s: float
    last_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Look(Request):
    """Request to follow the control loop of process `pid`; 0: the loop that started last."""

    pid: Annotated[int, Ge(0), Le(2**31)]


@dataclass(frozen=True, kw_only=True, slots=True)
class AskRegions(Request):
    """Request the largest passive and stable stiffness (SI) at a damping, for a rig with changed settings."""

    damping: Annotated[float, Ge(0), Le(1e9)]
    rig: Name = "koul-compliant"
    changes: Changes = field(default_factory=dict)
    delay_ticks: Annotated[int, Ge(0), Le(40)] = 1


@dataclass(frozen=True, kw_only=True, slots=True)
class AskExperiment(Request):
    """Request all settings of an experiment, in real time and with changed settings, and their digest; nothing runs."""

    rig: Name = "koul-compliant"
    changes: Changes = field(default_factory=dict)


_adapters: dict[type[Request], Any] = {}


def request_of(text: str | bytes, kinds: Mapping[str, type[Request]]) -> Request:
    """Return the checked request in a JSON message; `kinds` has the class for each value of the field `do`.

    Raises `ConfigError` if the message is not a request, or one of its fields is not valid.
    """
    do = json_of(text).get("do")
    if not isinstance(do, str) or do not in kinds:
        raise ConfigError(f"unknown request {shown(do)}", remedy=f"send one of {', '.join(kinds)}")
    kind = kinds[do]
    if kind not in _adapters:
        _adapters[kind] = pydantic.TypeAdapter(kind)
    try:
        found: Request = _adapters[kind].validate_json(text)
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        given = "" if first["type"] == "missing" else f" = {shown(first['input'])}"
        remedy = f"send {where or 'a request'} as defined by {kind.__name__}"
        problem = f"request {do}: field {where}{given} is not valid: {first['msg']}"
        raise ConfigError(problem, remedy=remedy) from None
    return found


def number_of(text: str | bytes) -> int:
    """Return the field `number` of a JSON message, even if the message is no valid request; 0 if it is missing."""
    number = json_of(text).get("number")
    return number if isinstance(number, int) and not isinstance(number, bool) else 0


def refuse_reserved(changes: Mapping[str, Any]) -> None:
    """Raise `ConfigError` if `changes` contain a setting that no page may change (`RESERVED`)."""
    for key in RESERVED:
        if key in changes:
            raise ConfigError(
                f"{key} cannot be changed from a page",
                remedy="set it in an experiment file and open that file",
            )


def json_of(text: str | bytes) -> dict[str, Any]:
    """Return the JSON object in a message; an empty dictionary if the message is not a JSON object."""
    try:
        value = json.loads(text)
    # Lists within lists, a few kilobytes of brackets, exhaust the parser's recursion.
    except (ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}
