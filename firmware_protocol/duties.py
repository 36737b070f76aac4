"""Duties of a port towards the core as data (`firmware/duties.toml`): the call, what must hold, how that is tested."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

PORTING = Path(__file__).with_name("firmware") / "PORTING.md"


@dataclass(frozen=True, slots=True, kw_only=True)
class Duty:
    """One row; the file says what its fields mean."""

    name: str
    call: str
    duty: str
    seen: str
    broken: str
    remedy: str


def duties() -> tuple[Duty, ...]:
    """Return every row, in the order of the file."""
    content = tomllib.loads(PORTING.with_name("duties.toml").read_text(encoding="utf-8"))
    return tuple(Duty(**row) for row in content["duty"])
