"""The boundary search of Chawda et al. (Fig. 5): along the edge of the passive walls instead of over all of them.

Stiffness rises until a wall is not passive; the damping then rises by a step, and from there stiffness falls until a
wall is passive or rises until one is not; and so on, until no stiffness is left. A pure walk over the numbers of rows
and columns: it yields a wall and is told whether that one is passive, whoever finds out.

It needs a tenth of the tests of a grid and believes two things for it: that the wall it starts from is passive, and
that each damping has one edge. Where a measured map is speckled it climbs from island to island, and where the start
fails by a bad line it ends at once, unless it may look for another; `trace_grid` shows it beside the grid itself.

Source: Chawda et al., section V and Fig. 5, which draws the steps. Not said there: what happens at the upper ends of
the ranges (here: the edge is capped there, and the walk ends at the last damping), and how a passive start is found
(here, if asked for: the damping rises until the start's stiffness is passive; these tests count).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Cell = tuple[int, int]  # number of the damping, number of the stiffness
Flags = NDArray[np.bool_]
Ending = Literal["no stiffness left", "last damping", "start not passive"]


@dataclass(frozen=True, slots=True)
class Trace:
    """What a search found, in numbers of dampings and stiffnesses.

    Attributes
    ----------
    tests
        Every wall in the order of its test, and whether it was passive.
    edge
        Highest stiffness that the search holds for passive at each damping from the start's on; −1: none.
    capped
        Dampings whose highest stiffness of all was passive: their edge lies beyond.
    ending
        Why the search ended.
    """

    tests: tuple[tuple[Cell, bool], ...]
    edge: tuple[tuple[int, int], ...]
    capped: tuple[int, ...]
    ending: Ending

    @property
    def path(self) -> list[Cell]:
        """The walls in the order of their tests."""
        return [cell for cell, _ in self.tests]


def boundary_search(
    dampings: int, stiffnesses: int, start: Cell = (0, 0), *, looks: bool = True
) -> Generator[Cell, bool, tuple[tuple[tuple[int, int], ...], tuple[int, ...], Ending]]:
    """Walk along the boundary of a grid: yields walls, is sent whether each is passive.

    Parameters
    ----------
    dampings, stiffnesses
        How many there are.
    start
        A wall that should be passive.
    looks
        Whether a start that is not passive may be followed by others with more damping.

    Returns
    -------
    edge, capped, ending
        As in `Trace`. No wall is yielded twice.
    """
    damping, stiffness = start
    edge: list[tuple[int, int]] = []
    capped: list[int] = []
    while not (yield damping, stiffness):
        edge.append((damping, -1))
        damping += 1
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


def trace(walk: Generator[Cell, bool, Any], oracle: Callable[[int, int], bool]) -> Trace:
    """Drive a walk with a function of damping and stiffness that says whether a wall is passive."""
    tests: list[tuple[Cell, bool]] = []
    cell = next(walk)
    while True:
        passive = bool(oracle(*cell))
        tests.append((cell, passive))
        try:
            cell = walk.send(passive)
        except StopIteration as end:
            return Trace(tuple(tests), *end.value)


@dataclass(frozen=True, slots=True)
class Comparison:
    """The search beside the grid that it walked over.

    Attributes
    ----------
    trace
        The walk.
    cells
        How many walls the grid has.
    connected
        The grid's own edge at each damping, as in `Trace.edge`.
    above, below
        At how many dampings the search ends above the edge of the connected region (on an island), or below it.
    unseen
        Dampings with passive walls that it never came to.
    """

    trace: Trace
    cells: int
    connected: tuple[int, ...]
    above: int
    below: int
    unseen: int

    @property
    def highest(self) -> int:
        """Largest stiffness on the edge that the search found; −1 if none."""
        return max(stiffness for _, stiffness in self.trace.edge)

    def as_mapping(self, stiffnesses: Sequence[float], dampings: Sequence[float]) -> dict[str, Any]:
        """Plain values, for JSON, in SI units; None for an edge that is not there."""

        def at(stiffness: int) -> float | None:
            return stiffnesses[stiffness] if stiffness >= 0 else None

        return {
            "tests": len(self.trace.tests),
            "of": self.cells,
            "ending": self.trace.ending,
            "highest": at(self.highest),
            "above": self.above,
            "below": self.below,
            "unseen": self.unseen,
            "path": [[dampings[b], stiffnesses[k]] for b, k in self.trace.path],
            "edge": [[dampings[b], at(k)] for b, k in self.trace.edge],
            "capped": [dampings[b] for b in self.trace.capped],
            "grid": [[dampings[b], at(k)] for b, k in enumerate(self.connected)],
        }


def trace_grid(passive: Flags, start: Cell = (0, 0), *, looks: bool = True) -> Comparison:
    """Search in a finished grid of verdicts, ``passive[damping, stiffness]``, and compare."""
    dampings, stiffnesses = passive.shape
    walk = boundary_search(dampings, stiffnesses, start, looks=looks)
    found = trace(walk, lambda b, k: bool(passive[b, k]))
    edges: list[int] = (connected(passive).sum(axis=1) - 1).tolist()
    searched = dict(found.edge)
    return Comparison(
        trace=found,
        cells=passive.size,
        connected=tuple(edges),
        above=sum(k > edges[b] for b, k in searched.items()),
        below=sum(k < edges[b] for b, k in searched.items()),
        unseen=sum(b not in searched and edge >= 0 for b, edge in enumerate(edges)),
    )


def connected(passive: Flags) -> Flags:
    """Walls that are passive together with all softer ones of their damping; ``passive[..., damping, stiffness]``."""
    return np.logical_and.accumulate(passive, axis=-1)
