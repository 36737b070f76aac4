"""Summarise a map of impedances like Table I of Chawda et al.: widths of the passive region, and its worst fidelity.

`rig impedance map` and the reproduced paper use this module. A wall is connected if it and all softer walls of its
damping are passive. *K-width* is the largest connected stiffness, *B-width* the largest damping with a connected wall.
Both are values of the grid, so accurate to one step; at the end of the grid they are only lower bounds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.analysis.impedance import Floats
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.present import reported
from rig.experiments.mapping._searches import Flags, GridSearch, connected, limit_of, trace_grid
from rig.experiments.mapping.zwidth_frequency import FrequencyMap

# C, μ1 and μ2 determine two gains, α = μ1·C and λ = μ2·√C, and count as two tuned values, as in the paper. A setting at
# its default does not count, although some defaults have an influence, like FOAW's longest window.
LEVANT_GAINS = ("lipschitz", "mu1", "mu2")
POINTS = 4  # common walls in the table


@dataclass(frozen=True, slots=True)
class PassiveIsland:
    """A range of passive walls above a wall that is not passive: damping, lowest and highest stiffness (SI)."""

    damping: float
    lowest: float
    highest: float


@dataclass(frozen=True, slots=True)
class FrequencyWidth:
    """Extent of the passive walls of one sampling scheme, in one realisation (random phases) or in all together.

    Stiffnesses are in N·m/rad or N/m, dampings and fidelity errors in N·m·s/rad or N·s/m. A wall is connected if it and
    all softer walls of its damping are passive.

    Attributes
    ----------
    stiffness, at_damping
        K-width (largest connected stiffness), and its damping; 0 and NaN if no wall is connected.
    stiffness_undamped
        Largest connected stiffness at B = 0; None if the grid does not include B = 0.
    damping
        B-width (largest damping with a connected wall); NaN if no wall is connected, 0 if walls are connected at B = 0
        only.
    worst_fidelity, worst_stiffness, worst_damping
        Largest fidelity error among the connected walls, and its wall; NaN if no wall is connected.
    cells, islands
        Number of connected walls, and ranges of passive walls that are not connected.
    gaps
        Dampings below the B-width without a connected wall.
    stiffness_capped, damping_capped
        True if connected walls reach the end of the grid, so that the width is a lower bound.
    """

    stiffness: float
    at_damping: float
    stiffness_undamped: float | None
    damping: float
    worst_fidelity: float
    worst_stiffness: float
    worst_damping: float
    cells: int
    islands: tuple[PassiveIsland, ...]
    gaps: tuple[float, ...]
    stiffness_capped: bool
    damping_capped: bool

    @classmethod
    def of(
        cls, passive: Flags, fidelity: Floats, stiffnesses: Sequence[float], dampings: Sequence[float]
    ) -> FrequencyWidth:
        """Return the extent of passive walls from verdicts and fidelity errors (SI), shape (damping, stiffness)."""
        # A passive wall above a wall that is not passive is an island: it is listed but does not count for the widths,
        # because an irregular map has islands at any stiffness.
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
            islands=tuple(
                PassiveIsland(float(damping), low, high)
                for damping, column in zip(dampings, passive.tolist(), strict=True)
                for low, high in limit_of(dict(zip(map(float, stiffnesses), column, strict=True))).islands
            ),
            gaps=tuple(b[:last][held[:last] == 0].tolist()),
            stiffness_capped=bool((held == len(k)).any()),
            damping_capped=some and last == len(b) - 1,
        )


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean, standard deviation and range of a number over the `count` realisations (random phases) with a value."""

    mean: float
    deviation: float
    lowest: float
    highest: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Return mean, deviation (NaN for one value) and range of the finite values; all NaN without one."""
        kept = [value for value in values if math.isfinite(value)]
        if not kept:
            return cls(math.nan, math.nan, math.nan, math.nan, 0)
        deviation = float(np.std(kept, ddof=1)) if len(kept) > 1 else math.nan
        return cls(float(np.mean(kept)), deviation, min(kept), max(kept), len(kept))


@dataclass(frozen=True, slots=True)
class SchemeWidths:
    """Extents of a scheme's passive walls: in all realisations (random phases) together, and in each alone."""

    together: FrequencyWidth
    each: tuple[FrequencyWidth, ...]

    @classmethod
    def of(cls, found: FrequencyMap, scheme: int) -> SchemeWidths:
        """Return the extents of the passive walls of the sampling scheme with index `scheme` in the map `found`."""
        plan = found.plan
        *each, together = (
            FrequencyWidth.of(
                found.passive[scheme, n], found.fidelity[scheme, n], plan.stiffnesses, plan.dampings
            )
            for n in range(plan.realisations + 1)
        )
        return cls(together, tuple(each))

    @reported
    def stiffness(self) -> Spread:
        """Return mean and range of the largest passive stiffness (N·m/rad or N/m) over all realisations."""
        return Spread.of([width.stiffness for width in self.each])

    @reported
    def damping(self) -> Spread:
        """Return mean and range of the largest damping of a passive wall (N·m·s/rad or N·s/m) over all realisations."""
        return Spread.of([width.damping for width in self.each])

    @reported
    def worst_fidelity(self) -> Spread:
        """Return mean and range of passive walls' largest fidelity error (N·m·s/rad or N·s/m) over realisations."""
        return Spread.of([width.worst_fidelity for width in self.each])


@dataclass(frozen=True, slots=True)
class Printed:
    """A column of Chawda et al., Table I: K-width (N/m), B-width, worst fidelity error (N·s/m), tuned values."""

    stiffness: float
    damping: float
    worst_fidelity: float
    tunable: int


# Chawda et al., Table I. By name of the estimator.
PAPER: Mapping[str, Printed] = {
    "fdm-butterworth": Printed(2.4e4, 160.0, 894.91, 1),
    "foaw-best": Printed(2.1e4, 120.0, 294.3, 0),
    "kalman": Printed(2.7e4, 100.0, 520.04, 1),
    "levant": Printed(3.6e4, 100.0, 614.19, 2),
}
PAPERS_RIG, PAPERS_RATE = "chawda-linear", 1000


@dataclass(frozen=True, slots=True)
class SchemeRow:
    """Results of one sampling scheme, as in a column of the paper's Table I.

    Attributes
    ----------
    scheme, label, estimator
        Scheme as text, label for a plot's legend, and name of the estimator.
    widths
        K-width, B-width and worst fidelity, for all realisations (draws of the phases) together and for each.
    tuned
        Names of the tuned parameters.
    common
        Fidelity error at each wall of `TableOne.points`: mean and range over realisations.
    common_mean
        Mean fidelity error over all walls that every scheme renders passively: mean and range over realisations.
    search
        Result of the paper's boundary search in this map.
    paper
        Column that the paper prints; None for another rig, rate or estimator.
    """

    scheme: str
    label: str
    estimator: str
    widths: SchemeWidths
    tuned: tuple[str, ...]
    common: tuple[Spread, ...]
    common_mean: Spread
    search: GridSearch
    paper: Printed | None


@dataclass(frozen=True, slots=True)
class TableOne:
    """A table like Table I of Chawda et al.: K-width, B-width and fidelity of each sampling scheme of a map.

    Common walls have damping above 0, and all `comparable` schemes render them and all softer walls passively.

    Attributes
    ----------
    rows
        Row for each scheme.
    points
        Some of the common walls (stiffness, damping).
    common_walls
        Number of common walls.
    comparable
        Indices of the schemes that have a connected wall (passive with all softer walls) with damping above 0.
    band_hz, realisations, stiffness_step, damping_step
        Band (Hz), number of realisations, and largest steps of the grid, on which all numbers depend.
    """

    rows: tuple[SchemeRow, ...]
    points: tuple[tuple[float, float], ...]
    common_walls: int
    comparable: tuple[int, ...]
    band_hz: tuple[float, float]
    realisations: int
    stiffness_step: float
    damping_step: float


def table_one(found: FrequencyMap) -> TableOne:
    """Return a table that summarises each sampling scheme of a map, like Table I of Chawda et al.

    Parameters
    ----------
    found
        Map of passive walls that `rig.impedance_map` returned.

    Returns
    -------
    TableOne
        For each scheme K-width and B-width (N·m/rad and N·m·s/rad, or N/m and N·s/m) with their spread over
        realisations, fidelity error (N·m·s/rad or N·s/m) at the common walls of all schemes, and the tuned parameters.
    """
    plan = found.plan
    regions = connected(found.passive[:, -1])  # of all realisations together
    damped = np.array(plan.dampings) > 0.0
    comparable = np.flatnonzero(regions[:, damped].any(axis=(1, 2)))
    # The paper compares estimators at different walls: an estimator that permits stiffer walls has a larger error only
    # because of these walls. So fidelity is also computed at walls that are connected for every scheme. They have
    # damping, because without damping the estimator has no effect.
    held = regions[comparable].all(axis=0) & damped[:, None] & (len(comparable) > 0)
    cells = _choose_spaced(np.argwhere(held))
    rows = []
    for number, scheme in enumerate(plan.schemes):
        controller = scheme.applied(plan.experiment).controller
        each = found.fidelity[number, :-1]
        rows.append(
            SchemeRow(
                scheme=scheme.text,
                label=scheme.label(plan.experiment),
                estimator=controller.estimator,
                widths=SchemeWidths.of(found, number),
                tuned=tuned_numbers(controller.estimator, controller.parameters),
                common=tuple(Spread.of(each[:, b, k].tolist()) for b, k in cells),
                common_mean=Spread.of(each[:, held].mean(axis=1).tolist() if held.any() else []),
                search=trace_grid(found.passive[number, -1], plan.dampings, plan.stiffnesses),
                paper=_papers(plan.experiment, scheme, controller.estimator),
            )
        )
    return TableOne(
        rows=tuple(rows),
        points=tuple((plan.stiffnesses[k], plan.dampings[b]) for b, k in cells),
        common_walls=int(held.sum()),
        comparable=tuple(comparable.tolist()),
        band_hz=plan.band_hz,
        realisations=plan.realisations,
        stiffness_step=_step(plan.stiffnesses),
        damping_step=_step(plan.dampings),
    )


def tuned_numbers(estimator: str, parameters: Mapping[str, float | str]) -> tuple[str, ...]:
    """Return the names of an estimator's numeric settings that are stated, which count as tuned."""
    names = [name for name, value in parameters.items() if not isinstance(value, str)]
    if estimator == "levant":
        others = [name for name in names if name not in LEVANT_GAINS]
        return ("alpha", "lambda", *others) if len(others) < len(names) else tuple(others)
    return tuple(names)


def _papers(experiment: Experiment, scheme: Scheme, estimator: str) -> Printed | None:
    rates = {scheme.position_rate, scheme.velocity_rate}
    own = experiment.rig.name == PAPERS_RIG and rates == {PAPERS_RATE}
    return PAPER.get(estimator) if own else None


def _choose_spaced(cells: np.ndarray[Any, np.dtype[np.int64]]) -> list[tuple[int, int]]:
    """Return up to four of the walls (index pairs), evenly spaced in the order of damping times stiffness."""
    if len(cells) == 0:
        return []
    order = np.argsort((cells[:, 0] + 1) * (cells[:, 1] + 1), kind="stable")
    chosen = np.unique(np.linspace(0, len(cells) - 1, POINTS).round().astype(int))
    return [(int(b), int(k)) for b, k in cells[order[chosen]]]


def _step(values: tuple[float, ...]) -> float:
    """Return the largest step between values of a grid's axis; 0 for a single value."""
    return float(np.diff(values).max()) if len(values) > 1 else 0.0
