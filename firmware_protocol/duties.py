"""Read the duties of a firmware port (`firmware/duties.toml`): called function, its duty, and how that is tested."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

PORTING = Path(__file__).with_name("firmware") / "PORTING.md"


@dataclass(frozen=True, slots=True, kw_only=True)
class Duty:
    """One duty; `duties.toml` explains the fields."""

    name: str
    call: str
    duty: str
    seen: str
    broken: str
    remedy: str


def duties() -> tuple[Duty, ...]:
    """Return all duties, in the order of the file."""
    content = tomllib.loads(PORTING.with_name("duties.toml").read_text(encoding="utf-8"))
    return tuple(Duty(**row) for row in content["duty"])
