"""The interface of an attack area, and the report of its cases; the seed, the area and a number determine each."""

import random
import subprocess
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Protocol

NAMESPACES = "unshare --mount --pid --fork --mount-proc --kill-child=KILL --propagation private"


class Finding(AssertionError):  # noqa: N818  (a test calls it so)
    """Raised by a case: an invariant does not hold."""


def require(holds: object, *what: object) -> None:
    """Raise `Finding` unless a condition holds; unlike `assert`, it also works under `python -O`."""
    if not holds:
        raise Finding(" ".join(map(str, what)))


@dataclass
class Outcome:
    """The result of one case without a new finding.

    Attributes
    ----------
    figures
        What it did, to be summed: runs, lies, exit codes.
    known
        Names of findings that are expected until they are fixed.
    """

    figures: Counter[str] = field(default_factory=Counter)
    known: Counter[str] = field(default_factory=Counter)


class Area(Protocol):
    """An attack area: the class that a module of this directory provides."""

    def __init__(self, place: Path) -> None:
        """Prepare the area in an empty directory that no other area uses."""

    def attack(self, case: int, chance: random.Random) -> Outcome:
        """Run one case; every exception that it raises is a finding."""
        ...


def chance_of(seed: int, area: str, case: int) -> random.Random:
    return random.Random(f"{seed}/{area}/{case}")


@cache
def isolation() -> tuple[str, ...]:
    """Return the command prefix that gives a program its own process and mount namespaces; empty if not permitted.

    In them a `rig stop` finds no other loop, a full disk belongs to it alone, and all dies with the first.
    """
    for user in ((), ("--user", "--map-root-user")):
        program, *options = NAMESPACES.split()
        command = (program, *user, *options)
        try:
            done = subprocess.run([*command, "true"], capture_output=True, timeout=10.0, check=False)
        except OSError:
            return ()
        if done.returncode == 0:
            return command
    return ()


SHOWN = 2000  # characters of a failure


@dataclass
class AreaReport:
    """The sums of one area, and each failure with the command that repeats it."""

    tries: int = 0
    seconds: float = 0.0
    figures: Counter[str] = field(default_factory=Counter)
    known: Counter[str] = field(default_factory=Counter)
    failures: dict[int, str] = field(default_factory=dict)  # case → what

    def add(self, answer: dict[str, Any]) -> None:
        self.tries += 1
        for kind in ("figures", "known"):
            getattr(self, kind).update(answer.get(kind, {}))
        if "failure" in answer:
            self.failures[answer["case"]] = answer["failure"]

    def lines(self, name: str, seed: int) -> list[str]:
        sums = ", ".join(
            f"{value:,} {what.replace('_', ' ')}" for what, value in sorted(self.figures.items())
        )
        lines = [
            f"{name}: {self.tries} tries in {self.seconds:.0f} s, {len(self.failures)} failures"
            + (f"; {sums}" if sums else "")
        ]
        lines += [f"  known: {what} ({times} times)" for what, times in sorted(self.known.items())]
        for case, what in self.failures.items():
            lines += [f"  FAILED: --only {name} --seed {seed} --case {case}", *_indent(what[:SHOWN])]
        return lines


def _indent(text: str) -> list[str]:
    return [f"    {line}" for line in text.splitlines()]
