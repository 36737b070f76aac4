"""Search for the walls that pass: choose the next wall to test, and find the limit at one damping or in a grid.

Maps of hits and of impedances use this module. A search is a generator: it yields a wall and receives the outcome of
its test by `send`, so that the caller can test walls in a simulation or on a device. `drive` runs a search.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import integrate
from rig.core.errors import ConfigError, PlanError

# ladder: test upwards from the lowest stiffness until a wall has failed under each criterion (Koul et al., section
# III); finds the end of the range that begins with soft walls. bisection: few trials, but assumes that a wall stiffer
# than a failed wall fails, too, which is wrong near the largest damping. grid: test every stiffness; also finds
# islands, stiff walls that pass although a softer wall fails.
Way = Literal["ladder", "bisection", "grid"]
Passes = bool | None  # None: the trial is invalid
Outcomes = Mapping[str, Passes]  # by criterion
Cell = tuple[int, int]  # index of the damping, index of the stiffness
Flags = NDArray[np.bool_]
Ending = Literal["no stiffness left", "last damping", "start not passive"]

MOST_NUMBERS = 10_000  # largest count of a range that is given as a text

Wall = TypeVar("Wall")
Answer = TypeVar("Answer")
Found = TypeVar("Found")


def check_values(
    name: str, values: Sequence[Any], option: str, *, below: float = math.inf, rising: bool = False
) -> None:
    """Raise `PlanError` if `values` is empty, or has a repeated value or a number outside 0 ≤ value < `below`.

    With `rising` the values must be in ascending order. `name` and `option` name the values in the message.
    """
    if not values:
        raise PlanError(f"{name} (`{option}`): the list is empty", remedy="give at least one value")
    twice = next((value for value, times in Counter(values).items() if times > 1), None)
    if twice is not None:
        raise PlanError(f"{name} (`{option}`): {twice} is given twice", remedy="give each value only once")
    wrong = [value for value in values if isinstance(value, int | float) and not 0.0 <= value < below]
    if wrong:
        raise PlanError(
            f"{name} (`{option}`): {wrong[0]:g} is out of range",
            remedy="choose finite numbers of at least 0"
            + ("" if below == math.inf else f" and less than {below:g}"),
        )
    if rising and list(values) != sorted(values):
        raise PlanError(f"{name} (`{option}`) are not in rising order", remedy="give the lowest value first")


def numbers_of(text: str, name: str) -> tuple[float, ...]:
    """Return the numbers of a text: a list ``0,0.5,1``, or an equally spaced range ``0:3.6:17`` (first, last, count).

    Raise `ConfigError` for any other text; `name` names the text in the message.
    """
    try:
        if ":" not in text:
            return tuple(float(part) for part in text.split(","))
        first, last, count = text.split(":")
        if 1 <= int(count) <= MOST_NUMBERS:
            return tuple(np.linspace(float(first), float(last), int(count)).tolist())
    except ValueError:
        pass
    raise ConfigError(
        f"{name} {text!r} is not a list of numbers",
        remedy=f"write them as 0,0.5,1 or as first:last:count, like 0:3.6:17, with a count of 1 to {MOST_NUMBERS}",
    )


def bounds_of(text: str, name: str) -> tuple[float, float]:
    """Return lowest and highest value of a text ``10:1000``; else raise `ConfigError`, which quotes `name`."""
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise ConfigError(
            f"{name} {text!r} is not a range of two numbers", remedy="write it as LOW:HIGH, like 10:1000"
        ) from None
    return low, high


def drive(search: Generator[Wall, Answer, Found], test: Callable[[Wall], Answer]) -> Found:
    """Run a search (generator): test each wall that it yields, send the outcome back, and return its result."""
    try:
        wall = next(search)
        while True:
            wall = search.send(test(wall))
    except StopIteration as end:
        found: Found = end.value
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class StiffnessSearch:
    """A search for a stiffness limit: range (N·m/rad or N/m), ratio of two tested values, method (like bisection)."""

    way: Way = "ladder"
    lowest: float
    highest: float
    ratio: float = 1.06

    def __post_init__(self) -> None:
        if not 0.0 < self.lowest < self.highest < math.inf:
            raise ValueError(
                f"stiffness from {self.lowest:g} to {self.highest:g} is not a rising range above zero"
            )
        if not 1.0001 <= self.ratio <= 1e6:
            raise ValueError(f"a ratio of {self.ratio:g} between two stiffnesses is outside of 1.0001 to 1e6")

    @property
    def rungs(self) -> list[float]:
        """Return all stiffnesses that may be tested, ascending, none above `highest` (N·m/rad or N/m)."""
        # Plus 1e-9: `highest` must be tested if it is a whole number of ratios above `lowest`, despite rounding.
        steps = math.floor(math.log(self.highest / self.lowest) / math.log(self.ratio) + 1e-9)
        return [self.lowest * self.ratio**step for step in range(steps + 1)]

    def walk(self, criteria: Sequence[str]) -> Generator[float, Outcomes, None]:
        """Yield each stiffness to test and receive if it passed, until the limit for each ripple criterion is known."""
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
    """Yield each stiffness to test once, by bisection for each criterion in turn; receive whether it passed."""
    tried: dict[int, Outcomes] = {}
    for criterion in criteria:
        # Test both ends first: if the stiffest wall passes, no bisection is needed.
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
class StiffnessLimit:
    """A limit of the stiffness at one damping, from the outcomes of the tested stiffnesses.

    Attributes
    ----------
    stiffness
        Highest stiffness that passed below every failure (N·m/rad or N/m); 0 if no stiffness passed there.
    failed_at
        Lowest stiffness that failed; None if no stiffness failed, so that the limit is only a lower bound.
    islands
        Ranges (lowest, highest) of stiffnesses that pass above a failure.
    unknown
        Number of invalid trials; an invalid trial neither passes nor fails.
    """

    stiffness: float
    failed_at: float | None
    islands: tuple[tuple[float, float], ...]
    unknown: int

    @property
    def capped(self) -> bool:
        """Return True if the limit is only a lower bound: a wall passed and no wall failed."""
        return self.failed_at is None and self.stiffness > 0.0


def limit_of(tried: Mapping[float, Passes]) -> StiffnessLimit:
    """Return the stiffness limit from the tested stiffnesses (SI): True: passed, False: failed, None: invalid."""
    stiffness, failed_at = 0.0, None
    islands: list[tuple[float, float]] = []
    connected = False  # whether the last valid outcome belongs to the current island
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
    return StiffnessLimit(stiffness, failed_at, tuple(islands), unknown)


@dataclass(frozen=True, slots=True)
class Extent:
    """An extent of the region of stable walls below a curve of stiffness limits over the damping.

    Attributes
    ----------
    damping
        Largest damping at which a wall passes (N·m·s/rad or N·s/m); 0 if no wall passes.
    area
        Area under the curve up to `damping`; a lower bound if there are holes, where the curve is zero.
    holes
        Smaller dampings at which no wall passed: the limit is below the softest tested wall, or does not exist.
    """

    damping: float
    area: float
    holes: tuple[float, ...]

    @classmethod
    def of(cls, dampings: Sequence[float], limits: Sequence[float]) -> Extent:
        """Return the extent of stable walls from limits of K (N·m/rad or N/m; 0: none) at ascending dampings."""
        k, b = np.array(limits), np.array(dampings)
        passing = np.flatnonzero(k > 0.0)
        if not len(passing):
            return cls(0.0, 0.0, ())
        end = int(passing[-1]) + 1
        return cls(
            damping=float(b[end - 1]),
            area=float(integrate.trapezoid(k[:end], b[:end])),
            holes=tuple(b[:end][k[:end] <= 0.0].tolist()),
        )


def connected(passive: Flags) -> Flags:
    """Return an array that is True for walls that are passive together with all softer walls of the same damping.

    Argument and result have the axes ``[..., damping, stiffness]``.
    """
    return np.logical_and.accumulate(passive, axis=-1)


# Boundary search ------------------------------------------------------------------------------------


Traced = tuple[tuple[tuple[int, int], ...], tuple[int, ...], Ending]  # edge, capped, ending of a `GridSearch`


def boundary_search(
    dampings: int, stiffnesses: int, start: Cell = (0, 0), *, looks: bool = True
) -> Generator[Cell, bool, Traced]:
    """Walk along the boundary of passive walls in a grid: yield each wall to test, and receive True if it is passive.

    The stiffness rises until a wall is not passive. Then the damping rises by a step, and the stiffness falls until a
    wall is passive, or rises until a wall is not passive, and so on, until no stiffness remains. The search needs a
    tenth of a grid's tests. It assumes that the start is passive, and that each damping has a single limit; in an
    irregular map the search may follow the boundary of an island (passive walls above a wall that is not passive).

    Parameters
    ----------
    dampings, stiffnesses
        Number of dampings and of stiffnesses in the grid.
    start
        Wall at which the search starts (index of damping, index of stiffness); it should be passive.
    looks
        True to try walls with more damping if the start is not passive.
    """
    damping, stiffness = start
    edge: list[tuple[int, int]] = []
    capped: list[int] = []
    while not (yield damping, stiffness):
        edge.append((damping, -1))
        damping += 1
        # Chawda et al. do not say how to find a passive start: here the damping rises, and these tests are counted.
        if not looks or damping == dampings:
            return tuple(edge), (), "start not passive"
    passive, fresh = True, False  # of the wall (damping, stiffness); whether it still has to be tested
    while True:
        if fresh:
            passive = yield damping, stiffness
        if passive:
            while passive and stiffness + 1 < stiffnesses:
                stiffness += 1
                passive = yield damping, stiffness
            # Nor do they specify the upper ends of the ranges: here the limit is capped, and the search ends at the
            # last damping.
            edge.append((damping, stiffness if passive else stiffness - 1))
            if passive:
                capped.append(damping)
        else:
            while not passive and stiffness > 0:
                stiffness -= 1
                passive = yield damping, stiffness
            edge.append((damping, stiffness if passive else -1))
            if not passive:
                return tuple(edge), tuple(capped), "no stiffness left"
        damping, fresh = damping + 1, True
        if damping == dampings:
            return tuple(edge), tuple(capped), "last damping"


@dataclass(frozen=True, slots=True)
class GridSearch:
    """Result of a search along the boundary of passive walls in a finished grid, and the grid's true boundary.

    A boundary ("edge") is the highest passive stiffness at each damping. A wall is a pair of indices into `dampings`
    and `stiffnesses`.

    Attributes
    ----------
    path
        Walls in the order of their tests.
    edge
        Edge that the search found, as pairs (damping, stiffness) from the start's damping on; stiffness −1: no passive
        wall.
    capped
        Dampings at which even the highest stiffness was passive, so that the true edge is higher.
    ending
        Reason for the end of the search.
    cells
        Number of walls in the grid.
    connected
        Index of the true edge at each damping: highest stiffness up to which all walls are passive; −1: no passive
        wall.
    dampings, stiffnesses
        Values of the grid.
    """

    path: tuple[Cell, ...]
    edge: tuple[tuple[int, int], ...]
    capped: tuple[int, ...]
    ending: Ending
    cells: int
    connected: tuple[int, ...]
    dampings: Sequence[float]
    stiffnesses: Sequence[float]

    @property
    def highest(self) -> int:
        """Return the index of the largest stiffness that the search found passive; −1 if no wall is passive."""
        return max(stiffness for _, stiffness in self.edge)

    @property
    def above(self) -> int:
        """Return the number of dampings at which the search ended above the true limit, on an isolated passive wall."""
        return sum(k > self.connected[b] for b, k in self.edge)

    @property
    def below(self) -> int:
        """Return the number of dampings at which the search ended below the true limit of passive walls."""
        return sum(k < self.connected[b] for b, k in self.edge)

    @property
    def unseen(self) -> int:
        """Return the number of dampings with passive walls that the search did not reach."""
        seen = dict(self.edge)
        return sum(b not in seen and k >= 0 for b, k in enumerate(self.connected))

    def as_mapping(self) -> dict[str, Any]:
        """Return the result as JSON values by name, in SI units; None marks a damping without passive walls."""
        dampings, stiffnesses = self.dampings, self.stiffnesses

        def walls(edge: Iterable[tuple[int, int]]) -> list[list[float | None]]:
            return [[dampings[b], stiffnesses[k] if k >= 0 else None] for b, k in edge]

        return {
            "tests": len(self.path),
            "of": self.cells,
            "ending": self.ending,
            "highest": stiffnesses[self.highest] if self.highest >= 0 else None,
            "above": self.above,
            "below": self.below,
            "unseen": self.unseen,
            "path": walls(self.path),
            "edge": walls(self.edge),
            "capped": [dampings[b] for b in self.capped],
            "grid": walls(enumerate(self.connected)),
        }


def trace_grid(
    passive: Flags,
    dampings: Sequence[float] = (),
    stiffnesses: Sequence[float] = (),
    *,
    start: Cell = (0, 0),
    looks: bool = True,
) -> GridSearch:
    """Search along the boundary of ``passive[damping, stiffness]``, and compare it with the grid's true limits.

    Indices replace `dampings` or `stiffnesses` that are not given; `looks` tries more damping for a passive start.
    """
    rows, columns = passive.shape
    path: list[Cell] = []

    def test(cell: Cell) -> bool:
        path.append(cell)
        return bool(passive[cell])

    edge, capped, ending = drive(boundary_search(rows, columns, start, looks=looks), test)
    return GridSearch(
        path=tuple(path),
        edge=edge,
        capped=capped,
        ending=ending,
        cells=passive.size,
        connected=tuple((connected(passive).sum(axis=1) - 1).tolist()),
        dampings=dampings or range(rows),
        stiffnesses=stiffnesses or range(columns),
    )
