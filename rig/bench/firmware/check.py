"""One question of a self test, and its answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Outcome = Literal["ok", "failed", "skipped"]


@dataclass(frozen=True, slots=True)
class Check:
    """One question and its answer."""

    name: str
    outcome: Outcome
    text: str
    remedy: str = ""
