"""Summarise a map of impedances: widths of the connected region, its worst fidelity, Table I of Chawda et al.

*K-width* is the largest passive stiffness connected with the lowest one of its damping; *B-width* the largest damping
whose lowest stiffness is passive. Both are numbers of the grid: true to a step, and only a lower bound at its end.
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

# C, μ1 and μ2 make two gains, α = μ1·C and λ = μ2·√C, and count as two, as in the paper. What keeps its default does
# not count, although some defaults matter: FOAW's longest window does.
LEVANT_GAINS = ("lipschitz", "mu1", "mu2")
POINTS = 4  # common walls that are shown


@dataclass(frozen=True, slots=True)
class PassiveIsland:
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
        Stiffness of the column B = 0; None when the grid has none.
    damping
        B-width; NaN when no damping holds anything (0 is a width: B = 0 holds).
    worst_fidelity, worst_stiffness, worst_damping
        Largest fidelity error over the connected region, and where (damping units; NaN without a region).
    cells, islands
        Walls in the connected region, and what lies beyond it.
    gaps
        Dampings below the B-width without a connected wall.
    stiffness_capped, damping_capped
        True if the grid ends before the region does.
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
        """Measure a grid of verdicts and errors, both of shape (dampings, stiffnesses)."""
        # A stiffer wall that passes beyond one that fails is an island, listed and not counted: a map in the speckle
        # has some of them at any stiffness.
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
    """Mean, standard deviation and range over realisations; `count` of them gave a finite value."""

    mean: float
    deviation: float
    lowest: float
    highest: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Summarise numbers; values that are not finite are left out. The deviation of fewer than two is NaN."""
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

    @reported
    def stiffness(self) -> Spread:
        """Return K-width over realisations; one that holds nothing counts as 0."""
        return Spread.of([width.stiffness for width in self.each])

    @reported
    def damping(self) -> Spread:
        """Return B-width over the realisations that hold something."""
        return Spread.of([width.damping for width in self.each])

    @reported
    def worst_fidelity(self) -> Spread:
        """Return the largest error over the realisations that hold something, each over its own region."""
        return Spread.of([width.worst_fidelity for width in self.each])


@dataclass(frozen=True, slots=True)
class Printed:
    """A column of the paper's Table I, measured on its rig: N/m, N·s/m, N·s/m, count."""

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
    """One estimator.

    Attributes
    ----------
    scheme, label, estimator
        Text form, legend, name.
    widths
        K-width, B-width, worst fidelity, by all realisations together and by each.
    tuned
        Names of the numbers that were tuned.
    common
        Fidelity at each of `TableOne.points`: over realisations.
    common_mean
        Fidelity over all common walls: the mean over walls, its spread over realisations.
    search
        The paper's boundary search in this map.
    paper
        The paper's column, for its own rig, rate and estimator.
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
    """The whole table.

    Attributes
    ----------
    rows
        One for each scheme.
    points
        Some of the common walls (stiffness, damping): with damping, and held by all `comparable` schemes.
    common_walls
        How many there are.
    comparable
        Numbers of the schemes that hold any wall with damping.
    band_hz, realisations, stiffness_step, damping_step
        Settings on which all numbers depend.
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
    """Summarise a map scheme by scheme, as Table I of Chawda et al. does.

    Parameters
    ----------
    found
        Result of `impedance_map`.

    Returns
    -------
    TableOne
        For each scheme K-width and B-width (N·m/rad and N·m·s/rad, or N/m and N·s/m) with their spread over
        realisations, fidelity (damping units) at walls that all schemes hold, and the tuned numbers.
    """
    plan = found.plan
    regions = connected(found.passive[:, -1])  # of all realisations together
    damped = np.array(plan.dampings) > 0.0
    comparable = np.flatnonzero(regions[:, damped].any(axis=(1, 2)))
    # The paper compares estimators at different walls: the largest error of one that allows stiffer walls is larger for
    # that alone. So fidelity is also shown at walls that are connected under every scheme, with damping, since without
    # it the estimator has no effect.
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
    """Return names of the numbers among an estimator's stated settings, as the paper counts them."""
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
    """Return some of the cells, evenly spaced in the order of damping times stiffness, the last among them."""
    if len(cells) == 0:
        return []
    order = np.argsort((cells[:, 0] + 1) * (cells[:, 1] + 1), kind="stable")
    chosen = np.unique(np.linspace(0, len(cells) - 1, POINTS).round().astype(int))
    return [(int(b), int(k)) for b, k in cells[order[chosen]]]


def _step(values: tuple[float, ...]) -> float:
    """Return the largest step of a grid's axis, 0 for a single value."""
    return float(np.diff(values).max()) if len(values) > 1 else 0.0
