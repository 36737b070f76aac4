"""The one vocabulary of checks: what was looked at, the outcome, and what to do about it.

A plan, the examination of a machine, the self test of a board and the limits of an excitation all consist of these.

Every room that examines or refuses something makes them. This file must not examine anything itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from rig.core.errors import PlanError


class Outcome(StrEnum):
    """The outcome of a check."""

    OK = "ok"
    WARNING = "warning"  # it works, less well or less surely
    REFUSED = "refused"  # what was asked for cannot be had, or must not be
    SKIPPED = "skipped"  # it could not be looked at


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was looked at.

    Attributes
    ----------
    name
        Name of the check, in a word or two.
    outcome
        Its outcome.
    text
        Result of the check: the value and the limit that it was compared with.
    remedy
        Instruction for all outcomes but ok; a command is written as one would type it, and is never run.
    why
        Why it matters, where a reader may not know.
    numbers
        Measured values; names end in their unit.
    changes
        New values by dotted key with which this check holds, where they can be computed.
    """

    name: str
    outcome: Outcome
    text: str
    remedy: str = ""
    why: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict)
    changes: Mapping[str, float] = field(default_factory=dict)

    @property
    def sentence(self) -> str:
        """Return the text and remedy, for a message of its own."""
        return ". ".join(filter(None, (self.text, self.remedy)))


def refused(checks: Iterable[Check]) -> tuple[Check, ...]:
    """Return the checks whose outcome is REFUSED."""
    return tuple(check for check in checks if check.outcome is Outcome.REFUSED)


def refuse(checks: Iterable[Check]) -> None:
    """Raise `PlanError` with everything that these checks refuse, and what to do."""
    if found := refused(checks):
        raise PlanError(
            "; ".join(f"{check.name}: {check.text}" for check in found),
            remedy="; ".join(dict.fromkeys(check.remedy for check in found)),
        )
