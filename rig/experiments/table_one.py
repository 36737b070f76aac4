"""Table I of Chawda et al. from a map: widths, worst fidelity and settings to tune, and fidelity at the same walls.

The paper's four columns compare estimators at different walls: the largest error of one that holds stiffer walls is
larger for that alone, and where the rig's inertia dominates it is that of the softest wall for all of them. So beside
them stands the fidelity at walls with damping (without it no estimator has a part) that all hold which hold any.

*Tunable numbers* are counted as the paper does: those that somebody chose for this map, which are the numbers that the
scheme or the experiment states. Levant's C, μ1 and μ2 make two gains, α = μ1·C and λ = μ2·√C, and count as two.
Options (words) and what keeps its default do not count, although some defaults matter: FOAW's longest window does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rig.analysis.impedance.estimate import plain
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.experiments.boundary_search import Comparison, connected, trace_grid
from rig.experiments.frequency_widths import SchemeWidths, Spread
from rig.experiments.zwidth_frequency import FrequencyMap

LEVANT_GAINS = ("lipschitz", "mu1", "mu2")
POINTS = 4  # common walls that are shown


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
    search: Comparison
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
        What all numbers depend on.
    """

    rows: tuple[SchemeRow, ...]
    points: tuple[tuple[float, float], ...]
    common_walls: int
    comparable: tuple[int, ...]
    band_hz: tuple[float, float]
    realisations: int
    stiffness_step: float
    damping_step: float

    def as_mapping(self, found: FrequencyMap) -> dict[str, Any]:
        """Plain values, for JSON."""
        plan = found.plan
        return {
            "rows": [
                {
                    "scheme": row.scheme,
                    "label": row.label,
                    "estimator": row.estimator,
                    "widths": row.widths.as_mapping(),
                    "tuned": list(row.tuned),
                    "common": [plain(asdict(spread)) for spread in row.common],
                    "common_mean": plain(asdict(row.common_mean)),
                    "search": row.search.as_mapping(plan.stiffnesses, plan.dampings),
                    "paper": None if row.paper is None else asdict(row.paper),
                }
                for row in self.rows
            ],
            "points": [list(point) for point in self.points],
            "common_walls": self.common_walls,
            "comparable": list(self.comparable),
            "band_hz": list(self.band_hz),
            "realisations": self.realisations,
            "stiffness_step": self.stiffness_step,
            "damping_step": self.damping_step,
        }


def table_one(found: FrequencyMap) -> TableOne:
    """Summarise a map scheme by scheme."""
    plan = found.plan
    regions = connected(found.passive[:, -1])  # of all realisations together
    damped = np.array(plan.dampings) > 0.0
    comparable = np.flatnonzero(regions[:, damped].any(axis=(1, 2)))
    held = regions[comparable].all(axis=0) & damped[:, None] & (len(comparable) > 0)
    cells = _spaced(np.argwhere(held))
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
                search=trace_grid(found.passive[number, -1]),
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
    """Names of the numbers among an estimator's stated settings, as the paper counts them."""
    names = [name for name, value in parameters.items() if not isinstance(value, str)]
    if estimator == "levant":
        others = [name for name in names if name not in LEVANT_GAINS]
        return ("alpha", "lambda", *others) if len(others) < len(names) else tuple(others)
    return tuple(names)


def _papers(experiment: Experiment, scheme: Scheme, estimator: str) -> Printed | None:
    rates = {scheme.position_rate, scheme.velocity_rate}
    own = experiment.rig.name == PAPERS_RIG and rates == {PAPERS_RATE}
    return PAPER.get(estimator) if own else None


def _spaced(cells: np.ndarray[Any, np.dtype[np.int64]]) -> list[tuple[int, int]]:
    """Some of the cells, evenly spaced in the order of damping times stiffness, the last among them."""
    if len(cells) == 0:
        return []
    order = np.argsort((cells[:, 0] + 1) * (cells[:, 1] + 1), kind="stable")
    chosen = np.unique(np.linspace(0, len(cells) - 1, POINTS).round().astype(int))
    return [(int(b), int(k)) for b, k in cells[order[chosen]]]


def _step(values: tuple[float, ...]) -> float:
    """Largest step of a grid's axis, 0 for a single value."""
    return float(np.diff(values).max()) if len(values) > 1 else 0.0
