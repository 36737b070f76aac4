"""What an area of the attack is: numbered cases, each of which follows from the seed, the area and its number alone."""

from __future__ import annotations

import random
import subprocess
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Protocol

NAMESPACES = (
    "unshare",
    "--mount",
    "--pid",
    "--fork",
    "--mount-proc",
    "--kill-child=KILL",
    "--propagation",
    "private",
)


class Finding(AssertionError):  # noqa: N818  (a test calls it so)
    """An invariant that does not hold."""


def require(holds: object, *what: object) -> None:
    """Raise `Finding` unless something holds; an assertion may be switched off, this may not."""
    if not holds:
        raise Finding(" ".join(map(str, what)))


@dataclass
class Outcome:
    """One case that found nothing new.

    Attributes
    ----------
    figures
        What it did, to be summed: bytes, ticks, ticks_armed, runs, kills, …
    known
        Names of findings that are expected until they are fixed.
    skipped
        What this machine did not permit.
    """

    figures: Counter[str] = field(default_factory=Counter)
    known: Counter[str] = field(default_factory=Counter)
    skipped: Counter[str] = field(default_factory=Counter)


class Area(Protocol):
    """One file of this directory."""

    def __init__(self, place: Path) -> None:
        """Prepare in an empty directory of its own."""

    def attack(self, case: int, chance: random.Random) -> Outcome:
        """Run one case; whatever it raises is a finding."""
        ...


def chance_of(seed: int, area: str, case: int) -> random.Random:
    """Return what a case draws from."""
    return random.Random(f"{seed}/{area}/{case}")


@cache
def isolation() -> tuple[str, ...]:
    """Command that gives a program processes and mounts of its own; empty where this user may not.

    In them a `rig stop` finds no other loop, a full disk belongs to it alone, and all dies with the first.
    """
    for command in (NAMESPACES, (NAMESPACES[0], "--user", "--map-root-user", *NAMESPACES[1:])):
        try:
            done = subprocess.run([*command, "true"], capture_output=True, timeout=10.0, check=False)
        except OSError:
            return ()
        if done.returncode == 0:
            return command
    return ()


@contextmanager
def mounted(place: Path, options: str) -> Iterator[bool]:
    """Mount a file system in memory at a place; yields False where this is not permitted."""
    place.mkdir(parents=True, exist_ok=True)
    command = ["mount", "-t", "tmpfs", "-o", options, "attack", str(place)]
    permitted = (
        bool(isolation()) and subprocess.run(command, capture_output=True, check=False).returncode == 0
    )
    try:
        yield permitted
    finally:
        if permitted:
            subprocess.run(["umount", "--lazy", str(place)], capture_output=True, check=False)
