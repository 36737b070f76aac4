"""Type of a check: the result of one examination, with its outcome and what to do about it.

A plan, the examination of a computer, a board's self test and the limits of an excitation consist of checks. Every
package that examines or refuses something returns checks. This file must not examine anything itself.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from rig.core.errors import PlanError


class Outcome(StrEnum):
    """Outcome of a check: ok, warning, refused (failed) or skipped."""

    OK = "ok"
    WARNING = "warning"  # it works, less well or less surely
    REFUSED = "refused"  # what was asked for cannot be had, or must not be
    SKIPPED = "skipped"  # it could not be looked at


@dataclass(frozen=True, slots=True)
class Check:
    """Result of one examination.

    Attributes
    ----------
    name
        Name of the check, in a word or two.
    outcome
        Outcome of the check.
    text
        Result of the check: the value and the limit that it was compared with.
    remedy
        What to do, for all outcomes but ok; a command is given as text to type, and is never run.
    why
        Why the result matters; empty if it is obvious.
    numbers
        Measured values; names end in their unit.
    changes
        New values by dotted key of the experiment with which this check passes, if they can be computed.
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
        """Return the check's result and remedy as one message."""
        return ". ".join(filter(None, (self.text, self.remedy)))


def refused(checks: Iterable[Check]) -> tuple[Check, ...]:
    """Return those of `checks` that failed (outcome REFUSED), in their order."""
    return tuple(check for check in checks if check.outcome is Outcome.REFUSED)


def refuse(checks: Iterable[Check]) -> None:
    """Raise `PlanError` with the texts and remedies of all failed checks; do nothing if no check failed."""
    if found := refused(checks):
        raise PlanError(
            "; ".join(f"{check.name}: {check.text}" for check in found),
            remedy="; ".join(dict.fromkeys(check.remedy for check in found)),
        )
