"""One thing that was looked at, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any


class Outcome(StrEnum):
    """How well it is."""

    OK = "ok"
    WARNING = "warning"  # the loop runs, less well or less surely
    PROBLEM = "problem"  # what was asked for cannot be had


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What was looked at, what is the case, why it matters and the one command that mends it."""

    name: str
    outcome: Outcome
    text: str
    why: str
    command: str = ""  # printed, never run
    numbers: Mapping[str, float] = field(default_factory=dict)  # what was measured; names end in their unit

    def as_mapping(self) -> dict[str, Any]:
        """Return JSON types."""
        return {**asdict(self), "outcome": str(self.outcome)}
