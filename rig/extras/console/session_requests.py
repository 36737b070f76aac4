"""Requests of a page about sessions: JSON objects, checked like the requests of `rig.extras.console.requests`."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Le, MaxLen

from rig.core.quantity import STRICT
from rig.extras.console.requests import Name, Request

Key = Annotated[str, MaxLen(40)]


@dataclass(frozen=True, kw_only=True, slots=True)
class ListSessions(Request):
    """Request the protocols that may be begun and the sessions that may be resumed."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SessionPerson:
    """Simulated participant of a rehearsal: thresholds, spread, lapse rate, and variation between people."""

    __pydantic_config__ = STRICT

    thresholds: Annotated[tuple[Name, ...], MaxLen(50)] = ()
    spread: float = 15.0
    lapse_rate: float = 0.0
    people_sd: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class BeginSession(Request):
    """Begin a session of `protocol` below the directory `study` (may be empty), or resume that in `directory`."""

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
    """A key that was pressed `shown_s` (s) after question number `asked` was shown."""

    key: Key
    asked: int = 0
    shown_s: Annotated[float, Ge(0)] | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class TypeLine(Request):
    """A typed line (a note, or the answer to an item) that was sent `shown_s` (s) after question `asked` was shown."""

    text: Annotated[str, MaxLen(2000)]
    asked: int = 0
    shown_s: Annotated[float, Ge(0)] | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Reach(Request):
    """Position of the dragged hand as a share (0 to 1) of its range, and `held`: True if it presses with full force."""

    share: Annotated[float, Ge(0), Le(1)]
    held: bool = False
