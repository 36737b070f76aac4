"""What reproducing a paper is: claims with verdicts that rules compute, sections of text, tables and pictures, numbers.

A reproduction is computed as many small parts in one sweep (`rig.experiments.sweep.run`), so that all of it has one
progress bar, one journal and one answer whoever computed what. Nothing in its text is written beforehand but the
questions: every verdict comes from a rule, every sentence about a result from that result's numbers.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import Any

from rig.experiments import sweep
from rig.experiments.sweep import Progress, Task

RUN_PART = "rig.papers.frame:run_part"


class Status(StrEnum):
    """What came of a claim."""

    REPRODUCED = "reproduced"
    ONLY_WITH = "reproduced only with"
    NOT = "not reproduced"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What a rule makes of numbers: a status, under which condition, and our number in words."""

    status: Status
    ours: str
    condition: str = ""

    @property
    def verdict(self) -> str:
        """The status with its condition."""
        return f"{self.status} {self.condition}".rstrip()


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """A row of the claims table.

    Attributes
    ----------
    key
        Short name, for machines.
    claim, paper
        What the paper says, and its number.
    finding
        Ours.
    needs
        What the claim hangs on, as far as this project knows.
    rule
        How the verdict follows from the numbers, with its thresholds.
    """

    key: str
    claim: str
    paper: str
    finding: Finding
    needs: str
    rule: str

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {**asdict(self), "verdict": self.finding.verdict}


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of texts under a head."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture by name; whoever draws knows the name."""

    name: str
    caption: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A question with its answer.

    Attributes
    ----------
    key, title
        Its anchor and its head.
    text
        Paragraphs: what it shows.
    conditions
        Under which conditions: rig, hand, word length, criterion, grids.
    """

    key: str
    title: str
    text: tuple[str, ...]
    conditions: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduction:
    """A finished reproduction.

    Attributes
    ----------
    name, title, source
        Of the paper: one word, a line, and where it was published.
    summary
        Paragraphs that stand first.
    claims, sections
        What the report shows.
    numbers
        Everything that was computed, in plain values; the same for the same plan and code.
    provenance
        Version, rigs, seeds, grids, counts; the same on every machine.
    seconds
        How long this run took, and how many parts it found already done.
    results
        What the pictures are drawn from.
    """

    name: str
    title: str
    source: str
    summary: tuple[str, ...]
    claims: tuple[Claim, ...]
    sections: tuple[Section, ...]
    numbers: Mapping[str, Any]
    provenance: Mapping[str, Any]
    seconds: float
    kept: int = 0
    results: Any = field(default=None, repr=False, compare=False)

    def __getitem__(self, key: str) -> Claim:
        """Return the claim of that key; `KeyError` if there is none."""
        for claim in self.claims:
            if claim.key == key:
                return claim
        raise KeyError(key)

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON: what is not finite is None."""
        mapping = {
            "name": self.name,
            "title": self.title,
            "claims": [claim.as_mapping() for claim in self.claims],
            "numbers": self.numbers,
            "provenance": self.provenance,
            "seconds": self.seconds,
            "kept": self.kept,
        }
        plain: dict[str, Any] = finite(mapping)
        return plain


@dataclass(frozen=True, slots=True)
class Part:
    """Some tasks of one kind: `work` as in `rig.experiments.sweep.run`; weights in hits of a 20 kHz rig."""

    work: str
    tasks: tuple[Task, ...]


def part(work: str, payload: Mapping[str, Any], weight: float) -> Part:
    """Return a part of one task."""
    return Part(work, (Task("all", payload, weight),))


def run_part(payload: Mapping[str, Any]) -> Any:
    """Run one task of a part, in plain values."""
    module, _, function = payload["work"].partition(":")
    return getattr(import_module(module), function)(payload["payload"])


@dataclass(frozen=True, slots=True)
class Parts:
    """Results of parts, by name."""

    results: Mapping[str, Sequence[Any]]
    seconds: float
    kept: int

    def one(self, name: str) -> Any:
        """Return the result of a part of one task."""
        (result,) = self.results[name]
        return result


def run_parts(
    parts: Mapping[str, Part],
    *,
    journal: Path | None = None,
    workers: int | None = None,
    watch: Callable[[Progress], None] | None = None,
) -> Parts:
    """Run everything as one sweep; parameters and errors as `rig.experiments.sweep.run`."""
    started = time.monotonic()
    tasks = [
        replace(task, key=f"{name}:{task.key}", payload={"work": part.work, "payload": task.payload})
        for name, part in parts.items()
        for task in part.tasks
    ]
    kept: list[int] = []

    def told(progress: Progress) -> None:
        kept[:] = [progress.kept]
        if watch is not None:
            watch(progress)

    results = sweep.run(RUN_PART, tasks, journal=journal, workers=workers, watch=told)
    by_name: dict[str, Sequence[Any]] = {}
    first = 0
    for name, some in parts.items():
        by_name[name] = results[first : first + len(some.tasks)]
        first += len(some.tasks)
    return Parts(by_name, time.monotonic() - started, kept[0] if kept else 0)


def finite(value: Any) -> Any:
    """Replace numbers that are not finite by None, so that every JSON reader takes it."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value


def shown(value: float | None, digits: int = 3) -> str:
    """Return a number for a table; an en dash when there is none."""
    if value is None or not math.isfinite(value):
        return "∞" if value == math.inf else "–"
    if value != 0.0 and 1.0 <= abs(value) < 10.0**6:
        decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        return f"{value:.{decimals}f}"
    return f"{value:.{digits}g}"


def over(one: float, other: float) -> float:
    """Return a ratio that is defined: nothing over nothing is 1, something over nothing infinite."""
    return one / other if other > 0.0 else (math.inf if one > 0.0 else 1.0)


def times(value: float | None) -> str:
    """Return a ratio, like ``× 1.25``."""
    return f"× {shown(value)}"


def within(value: float, target: float, factor: float) -> bool:
    """Whether a value is within a factor of a target, both ways; nothing not above zero is."""
    return value > 0.0 and target / factor <= value <= target * factor


def verdict_over(cases: Mapping[str, bool], ours: str, *, unconditional: Sequence[str] = ()) -> Finding:
    """Judge a claim that was tried in several cases.

    Reproduced when it held in all of them (or in all of those named `unconditional`, if any are named), not reproduced
    when in none, otherwise reproduced only with those in which it held.
    """
    held = [name for name, holds in cases.items() if holds]
    needed = list(unconditional) or list(cases)
    if cases and all(cases[name] for name in needed):
        return Finding(status=Status.REPRODUCED, ours=ours)
    if held:
        return Finding(status=Status.ONLY_WITH, ours=ours, condition="; ".join(held))
    return Finding(status=Status.NOT, ours=ours)
