"""What a page may ask for of sessions; as `rig.extras.console.requests`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Le, MaxLen

from rig.core.quantity import STRICT
from rig.extras.console.requests import Name, Request

Key = Annotated[str, MaxLen(40)]


@dataclass(frozen=True, kw_only=True, slots=True)
class ListSessions(Request):
    """What may be begun and resumed."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SessionPerson:
    """Who is rehearsed (`rig.session.engine._rehearsal.Person`)."""

    __pydantic_config__ = STRICT

    thresholds: Annotated[tuple[Name, ...], MaxLen(50)] = ()
    spread: float = 15.0
    lapse_rate: float = 0.0
    people_sd: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class BeginSession(Request):
    """Begin a session of a protocol, or resume that of a directory; as `rig session run` and `resume`.

    `study` is the directory of all participants, unless empty.
    """

    protocol: Name = ""
    code: Name = ""
    directory: Name = ""
    study: Name = ""
    row: Annotated[int, Ge(0)] | None = None
    person: SessionPerson | None = None
    realtime: bool = False
    again: bool = False
    at: Literal["trial", "block"] = "trial"
    other_device: bool = False
    other_protocol: bool = False
    url: Name = ""
    hand: Literal["simulated", "mouse", "keyboard"] = "simulated"
    arm_anyway: bool = False
    lossy_anyway: bool = False
    lsl: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class PressKey(Request):
    """A key at the desk, `shown_s` after question `asked` could be read."""

    key: Key
    asked: int = 0
    shown_s: Annotated[float, Ge(0)] | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class TypeLine(Request):
    """A line where one is wanted: a note, or the answer to an item."""

    text: Annotated[str, MaxLen(2000)]
    asked: int = 0
    shown_s: Annotated[float, Ge(0)] | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Reach(Request):
    """How far the dragged hand reaches, as a share of its way, and whether it presses with full force."""

    share: Annotated[float, Ge(0), Le(1)]
    held: bool = False
