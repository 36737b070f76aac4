"""What a frequency-domain map amounts to: widths of the connected region, its islands, its worst fidelity.

*K-width* is the largest passive stiffness that is connected with the lowest one of its damping: a stiffer wall that
passes beyond one that fails is an island, listed and not counted, because a map in the speckle has some of them at
any stiffness. *B-width* is the largest damping whose lowest stiffness is passive, whatever lies between; dampings
below it that hold nothing are its gaps. Both are numbers of the grid: true to a step, and only a lower bound where
they reach its end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rig.analysis.impedance.estimate import plain
from rig.analysis.impedance.signals import Floats
from rig.experiments.boundary_search import Flags, connected
from rig.experiments.zwidth_frequency import FrequencyMap


@dataclass(frozen=True, slots=True)
class Island:
    """Passive walls beyond one that is not: a damping, and the lowest and the highest stiffness."""

    damping: float
    lowest: float
    highest: float


@dataclass(frozen=True, slots=True)
class FrequencyWidth:
    """One scheme's map, by one realisation or by all together.

    Attributes
    ----------
    stiffness, at_damping
        K-width, and the damping at which it is reached; 0 and NaN where nothing is connected.
    stiffness_undamped
        Of the column B = 0; None when the grid has none.
    damping
        B-width; NaN when no damping holds anything (0 is a width: B = 0 holds).
    worst_fidelity, worst_stiffness, worst_damping
        Largest fidelity error over the connected region, and where (damping units; NaN without a region).
    cells, islands
        Walls in the connected region, and what lies beyond it.
    gaps
        Dampings below the B-width without a connected wall.
    stiffness_capped, damping_capped
        Whether the grid ends before the region does.
    """

    stiffness: float
    at_damping: float
    stiffness_undamped: float | None
    damping: float
    worst_fidelity: float
    worst_stiffness: float
    worst_damping: float
    cells: int
    islands: tuple[Island, ...]
    gaps: tuple[float, ...]
    stiffness_capped: bool
    damping_capped: bool

    @classmethod
    def of(
        cls, passive: Flags, fidelity: Floats, stiffnesses: Sequence[float], dampings: Sequence[float]
    ) -> FrequencyWidth:
        """Measure a grid of verdicts and errors, both of shape (dampings, stiffnesses)."""
        region = connected(passive)
        held = region.sum(axis=1)
        holding = np.flatnonzero(held)
        k, b = np.asarray(stiffnesses), np.asarray(dampings)
        widest = int(np.argmax(held))
        worst = np.where(region, fidelity, -math.inf)
        row, column = np.unravel_index(int(np.argmax(worst)), worst.shape)
        some = len(holding) > 0
        edges = np.where(held > 0, k[np.maximum(held - 1, 0)], 0.0)
        last = int(holding[-1]) if some else 0
        return cls(
            stiffness=float(edges[widest]),
            at_damping=float(b[widest]) if some else math.nan,
            stiffness_undamped=float(edges[0]) if b[0] == 0.0 else None,
            damping=float(b[last]) if some else math.nan,
            worst_fidelity=float(worst[row, column]) if some else math.nan,
            worst_stiffness=float(k[column]) if some else math.nan,
            worst_damping=float(b[row]) if some else math.nan,
            cells=int(region.sum()),
            islands=_islands(passive & ~region, k, b),
            gaps=tuple(b[:last][held[:last] == 0].tolist()),
            stiffness_capped=bool((held == len(k)).any()),
            damping_capped=some and last == len(b) - 1,
        )

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return dict(plain(asdict(self)))


def _islands(beyond: Flags, k: Floats, b: Floats) -> tuple[Island, ...]:
    padded = np.pad(beyond, ((0, 0), (1, 1))).astype(np.int8)
    steps = np.diff(padded, axis=1)
    begins, ends = np.argwhere(steps == 1), np.argwhere(steps == -1)
    return tuple(
        Island(float(b[row]), float(k[first]), float(k[after - 1]))
        for (row, first), (_, after) in zip(begins.tolist(), ends.tolist(), strict=True)
    )


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean, standard deviation and range over realisations; `count` of them said something."""

    mean: float
    deviation: float
    lowest: float
    highest: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Summarise numbers; those that are none are left out. The deviation of fewer than two is NaN."""
        kept = [value for value in values if math.isfinite(value)]
        if not kept:
            return cls(math.nan, math.nan, math.nan, math.nan, 0)
        deviation = float(np.std(kept, ddof=1)) if len(kept) > 1 else math.nan
        return cls(float(np.mean(kept)), deviation, min(kept), max(kept), len(kept))


@dataclass(frozen=True, slots=True)
class SchemeWidths:
    """Widths of one scheme: by all realisations together, and by each alone."""

    together: FrequencyWidth
    each: tuple[FrequencyWidth, ...]

    @classmethod
    def of(cls, found: FrequencyMap, scheme: int) -> SchemeWidths:
        """Measure a scheme of a map by its number."""
        plan = found.plan
        *each, together = (
            FrequencyWidth.of(
                found.passive[scheme, n], found.fidelity[scheme, n], plan.stiffnesses, plan.dampings
            )
            for n in range(plan.realisations + 1)
        )
        return cls(together, tuple(each))

    @property
    def stiffness(self) -> Spread:
        """K-width over realisations; one that holds nothing counts as 0."""
        return Spread.of([width.stiffness for width in self.each])

    @property
    def damping(self) -> Spread:
        """B-width over the realisations that hold something."""
        return Spread.of([width.damping for width in self.each])

    @property
    def worst_fidelity(self) -> Spread:
        """Largest error over the realisations that hold something, each over its own region."""
        return Spread.of([width.worst_fidelity for width in self.each])

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "together": self.together.as_mapping(),
            "each": [width.as_mapping() for width in self.each],
            **{
                name: plain(asdict(getattr(self, name)))
                for name in ("stiffness", "damping", "worst_fidelity")
            },
        }
