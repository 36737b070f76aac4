"""Which stiffness to try next, and where the limit lies: three ways through the same rungs.

* **ladder**: upwards from the lowest rung until everything has failed, as in Koul et al., section III. It finds the
  end of the range that is connected with soft walls, and costs most where walls are stable.
* **bisection**: halves the rungs between a pass and a failure. A few trials, but it believes that a wall harder than a
  failing one fails too, which is not so near the largest damping.
* **grid**: every rung. Shows islands: hard walls that hold where a softer one does not.

A rung may pass, fail or say nothing (the trial was invalid). One that says nothing neither ends a climb nor counts as
a limit.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

Way = Literal["ladder", "bisection", "grid"]
Passes = bool | None  # None: the trial says nothing
Outcomes = Mapping[str, Passes]  # by criterion


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """Rungs of equal ratio from the lowest stiffness to the highest, and the way through them."""

    way: Way = "ladder"
    lowest: float
    highest: float
    ratio: float = 1.06

    def __post_init__(self) -> None:
        if not 0.0 < self.lowest < self.highest < math.inf:
            raise ValueError(f"stiffness from {self.lowest:g} to {self.highest:g} is no range above zero")
        if not 1.0001 <= self.ratio <= 1e6:
            raise ValueError(f"a ratio of {self.ratio:g} between rungs is not in 1.0001 to 1e6")

    @property
    def rungs(self) -> list[float]:
        """All stiffnesses, ascending; the last one does not exceed the highest."""
        steps = math.floor(math.log(self.highest / self.lowest) / math.log(self.ratio) + 1e-9)
        return [self.lowest * self.ratio**step for step in range(steps + 1)]

    def walk(self, criteria: Sequence[str]) -> Generator[float, Outcomes, None]:
        """Yield the next stiffness to try and receive what came of it, until every criterion has its limit."""
        rungs = self.rungs
        if self.way == "bisection":
            yield from _bisect(rungs, criteria)
            return
        failed: set[str] = set()
        for stiffness in rungs:
            outcomes = yield stiffness
            failed |= {criterion for criterion in criteria if outcomes[criterion] is False}
            if self.way == "ladder" and failed.issuperset(criteria):
                return


def _bisect(rungs: list[float], criteria: Sequence[str]) -> Generator[float, Outcomes, None]:
    """For each criterion in turn between its highest pass and its lowest failure; no rung is tried twice."""
    tried: dict[int, Outcomes] = {}
    for criterion in criteria:
        # The ends first: most walls hold somewhere, and a cap that is reached needs no search.
        low, high, ends = -1, len(rungs), [0, len(rungs) - 1]
        while high - low > 1:
            index = ends.pop(0) if ends else (low + high) // 2
            if index not in tried:
                tried[index] = yield rungs[index]
            if tried[index][criterion] is False:
                high = min(high, index)
            else:
                low = max(low, index)


@dataclass(frozen=True, slots=True)
class Limit:
    """Where a wall of one damping stops being stable, from the rungs that were tried.

    Attributes
    ----------
    stiffness
        Highest rung that passed below every failure; 0 when none did.
    failed_at
        Lowest rung that failed; None when none did: the limit is then only a cap.
    islands
        Ranges of rungs that pass above a failure, (lowest, highest).
    unknown
        How many rungs said nothing.
    """

    stiffness: float
    failed_at: float | None
    islands: tuple[tuple[float, float], ...]
    unknown: int

    @property
    def capped(self) -> bool:
        """Whether the search ended before the wall did: some wall held and none failed."""
        return self.failed_at is None and self.stiffness > 0.0


def limit_of(tried: Mapping[float, Passes]) -> Limit:
    """Find the limit in what came of the rungs, by stiffness."""
    stiffness, failed_at = 0.0, None
    islands: list[tuple[float, float]] = []
    connected = False  # whether the last rung that said something belongs to the current island
    for rung in sorted(tried):
        passes = tried[rung]
        if passes is None:
            continue
        if not passes:
            failed_at = rung if failed_at is None else failed_at
            connected = False
        elif failed_at is None:
            stiffness = rung
        elif connected:
            islands[-1] = (islands[-1][0], rung)
        else:
            islands.append((rung, rung))
            connected = True
    unknown = sum(passes is None for passes in tried.values())
    return Limit(stiffness, failed_at, tuple(islands), unknown)
