"""What a page may ask for: one JSON object each, `do` names what, `number` is the page's own and comes back.

Every field is checked by type and range before anything is done; an unknown field is an error.
"""

from __future__ import annotations

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
RESERVED = ("wall.law",)  # a page chooses no program
MOST_BYTES = 1 << 16  # of a message


@dataclass(frozen=True, kw_only=True, slots=True)
class Request:
    """Any request."""

    do: Name
    number: Annotated[int, Ge(0), Le(2**53)] = 0

    __pydantic_config__ = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Operate(Request):
    """Operate, or operate no more: of all pages one does."""

    take: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Stop(Request):
    """Zero effort for every loop of this user. Any page may."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Run(Request):
    """Start a run: `rig` is a built-in one or a file, `is_detached` lets it outlive the page."""

    job: Literal["hit", "play"]
    rig: Name = "koul-compliant"
    url: Name = "sim://"
    changes: Changes = field(default_factory=dict)
    duration_s: Annotated[float, Ge(1), Le(3600)] = 120.0
    is_detached: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Set(Request):
    """Change the wall of the loop that is looked at, as `rig set` does."""

    changes: Changes


@dataclass(frozen=True, kw_only=True, slots=True)
class Hand(Request):
    """Where the dragged hand wants to be (rad or m, at the link), and its press (N)."""

    position: float
    press: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Show(Request):
    """What the page's scope shows from now on; `paused`: nothing new."""

    columns: Annotated[tuple[Name, ...], MaxLen(100)] = DEFAULT
    window_s: float = 2.0
    trigger: Trigger | None = None
    paused: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Zoom(Request):
    """A stretch of what the loop has left (s since its first row), in detail, while paused."""

    columns: Annotated[tuple[Name, ...], MaxLen(100)] = DEFAULT
    first_s: float
    last_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Cut(Request):
    """Save a stretch of the loop that is looked at (s since its first row) as a recording of its own."""

    first_s: float
    last_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Look(Request):
    """Look at the loop of another process; 0: at whichever began last."""

    pid: Annotated[int, Ge(0), Le(2**31)]


@dataclass(frozen=True, kw_only=True, slots=True)
class AskRegions(Request):
    """Which walls are passive and stable at a damping, on a rig with some changes, in real time."""

    damping: Annotated[float, Ge(0), Le(1e9)]
    rig: Name = "koul-compliant"
    changes: Changes = field(default_factory=dict)
    delay_ticks: Annotated[int, Ge(0), Le(40)] = 1


@dataclass(frozen=True, kw_only=True, slots=True)
class AskExperiment(Request):
    """The experiment as it would run in real time, with what may be set in it."""

    rig: Name = "koul-compliant"
    changes: Changes = field(default_factory=dict)


_adapters: dict[type[Request], Any] = {}


def request_of(text: str | bytes, kinds: Mapping[str, type[Request]]) -> Request:
    """Check a message, of one of these kinds by its `do`.

    Raises
    ------
    ConfigError
        It is no request, or a field of it is wrong.
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
        raise ConfigError(f"{do}: {where}{given}: {first['msg']}", remedy=remedy) from None
    return found


def number_of(text: str | bytes) -> int:
    """Return the number that a page gave its message, right or wrong; 0: none."""
    number = json_of(text).get("number")
    return number if isinstance(number, int) and not isinstance(number, bool) else 0


def refuse_reserved(changes: Mapping[str, Any]) -> None:
    """Raise `ConfigError` for a key that no page may change."""
    for key in RESERVED:
        if key in changes:
            raise ConfigError(
                f"{key} cannot be changed from a page",
                remedy="set it in an experiment file and open that file",
            )


def json_of(text: str | bytes) -> dict[str, Any]:
    """Return the object that a message holds; an empty one where it holds none."""
    try:
        value = json.loads(text)
    # Lists within lists, a few kilobytes of brackets, exhaust the parser's recursion.
    except (ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}
