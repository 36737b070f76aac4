"""The report of an attack: sums and failures of each area."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

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
