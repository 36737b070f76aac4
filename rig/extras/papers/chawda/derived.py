"""Compute from the results of Chawda et al. the numbers that the claims, the page and the pictures share.

A *reading* is one passivity test (a frequency band and a phase tolerance), since the paper does not state its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from rig.config import presets
from rig.config.schemes import Scheme
from rig.experiments.mapping.interface import FrequencyWidth, Spread, connected, tuned_numbers
from rig.extras.papers.chawda import rigs, rules
from rig.extras.papers.chawda.parts import fidelity_without_wall
from rig.extras.papers.chawda.readings import Readings
from rig.extras.papers.chawda.results import Chawda, spread
from rig.extras.papers.rules import over

# --- wall hits ---------------------------------------------------------------------------------------------------


def curve(chawda: Chawda, name: str) -> list[float]:
    """Return, for each damping of Fig. 3, the largest stiffness (N/m) at which hits are stable without velocity ripple.

    `name` is one of `Chawda.hit_names`; each value is a mean over the encoder offsets.
    """
    return [b.stiffness for b in chawda.hits.curve(chawda.hit_names.index(name), "felt")]


def drops(chawda: Chawda) -> dict[str, float]:
    """Return, by scheme, the damping (N·s/m) from which on the stiffness limit of Fig. 3 stays below half of its peak.

    The damping is infinite for a sampling scheme whose limit never stays below half of its peak.
    """
    dampings = chawda.scale.hit_dampings
    return {name: rules.find_drop(dampings, curve(chawda, name)) for name in chawda.hit_names}


def over_filtered(chawda: Chawda, name: str, up_to: float = math.inf) -> list[float]:
    """Return a sampling scheme's stiffness limit divided by that with the filtered difference, at each damping.

    Dampings are above 0 and at most `up_to` (N·s/m), without those at which both limits exceed the searched
    stiffnesses.
    """
    of, filtered = (chawda.hits.curve(chawda.hit_names.index(one), "felt") for one in (name, rigs.FILTERED))
    return [
        over(a.stiffness, b.stiffness)
        for a, b in zip(of, filtered, strict=True)
        if 0.0 < a.damping <= up_to and not (a.capped and b.capped)
    ]


def akf_over_fdm(chawda: Chawda) -> dict[str, list[float]]:
    """Return the stiffness limit with the Kalman filter divided by the limit with the filtered difference.

    The keys name the method: linear theory, or hits at 1 kHz. A value has one ratio for each damping of at least
    `rules.LEAST_DAMPING` (N·s/m) that the linear theory covers.
    """
    akf, fdm = (chawda.linear[name]["stable"] for name in (rigs.AKF, rigs.FDM))
    linear = [
        over(kalman, filtered)
        for damping, kalman, filtered in zip(chawda.linear_dampings, akf, fdm, strict=True)
        if damping >= rules.LEAST_DAMPING
    ]
    hits = [
        over(kalman.stiffness, filtered.stiffness)
        for kalman, filtered in zip(
            *(chawda.slow_hits.curve(rigs.ESTIMATORS.index(name), "felt") for name in (rigs.AKF, rigs.FDM)),
            strict=True,
        )
        if rules.LEAST_DAMPING <= kalman.damping <= chawda.linear_dampings[-1]
    ]
    return {"linear theory, stable": linear, "hits at 1 kHz": hits}


# --- Table I and what the band decides ---------------------------------------------------------------------------


def by_edge(chawda: Chawda) -> dict[float, list[tuple[bool, bool]]]:
    """Compare the results with Table I, for each upper edge (Hz) of the frequency band of the passivity test.

    There is a pair for each passivity test with this edge and each measurement: True if all K-widths (stiffest passive
    walls) are within a factor of `rules.NEAR_WIDTH` of Table I, and True if all fidelity errors are.
    """
    fits: dict[float, list[tuple[bool, bool]]] = {high: [] for high in rigs.HIGHEST_HZ}
    stiffness = {name: printed.stiffness for name, printed in rigs.PRINTED.items()}
    error = {name: printed.worst_fidelity for name, printed in rigs.PRINTED.items()}
    for number, of in enumerate(chawda.read):
        widths = {name: width.stiffness for name, width in of.items()}
        errors = {name: float(np.nan_to_num(width.worst_fidelity)) for name, width in of.items()}
        near = rules.near_table(widths, stiffness, chawda.scale.rung), rules.near_table(errors, error)
        fits[rigs.READINGS[number % len(rigs.READINGS)].high_hz].append(near)
    return fits


def closed_widths(chawda: Chawda, name: str) -> list[float]:
    """Return the stiffest wall (N/m) that linear theory calls passive at any damping, for each upper edge of the band.

    `name` is the name of a linear estimator.
    """
    return [max(of) for of in chawda.linear[name]["passive"]]


@cache
def mass_and_damping() -> tuple[float, float]:
    """Return the mass (kg) and the viscous damping (N·s/m) of the paper's rig, motor and link together."""
    mechanics = presets.load(rigs.RIG).rig.mechanics
    return mechanics.motor_inertia + mechanics.link_inertia, mechanics.motor_damping + mechanics.link_damping


def floors() -> dict[float, float]:
    """Return the rms of |Z| (N·s/m) of the rig without a wall, by upper edge (Hz) of the frequency band.

    The largest fidelity error that a measurement finds over all walls can hardly be smaller.
    """
    low, _ = rigs.CONTROL_BAND
    return {high: fidelity_without_wall(*mass_and_damping(), (low, high)) for high in rigs.HIGHEST_HZ}


def edge_of(error: float) -> float:
    """Return the upper edge (Hz) of the band in which the rms of |Z| of the rig without a wall is `error` (N·s/m)."""
    edges, (low, _) = np.arange(2.0, 1000.0), rigs.CONTROL_BAND
    errors = [fidelity_without_wall(*mass_and_damping(), (low, float(edge))) for edge in edges]
    return float(np.interp(error, errors, edges))


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """Results of all passivity tests that share one upper edge of the frequency band, `high` (Hz).

    Attributes
    ----------
    closed_fdm, closed_akf
        Stiffest wall (N/m) that linear theory calls passive, with FDM+filter and with the Kalman filter.
    floor
        Fidelity error without a wall (N·s/m).
    widths, errors, both
        Number of results with all K-widths near Table I, with all fidelity errors near Table I, and with both.
    readings
        Number of results: passivity tests with this edge times measurements.
    """

    high: float
    closed_fdm: float
    closed_akf: float
    floor: float
    widths: int
    errors: int
    both: int
    readings: int


def edges(chawda: Chawda) -> list[Edge]:
    """Return an `Edge` (results that depend on the frequency band) for each upper edge in `rigs.HIGHEST_HZ`."""
    closed = zip(*(closed_widths(chawda, name) for name in (rigs.FDM, rigs.AKF)), strict=True)
    return [
        Edge(
            high=high,
            closed_fdm=fdm,
            closed_akf=akf,
            floor=floors()[high],
            widths=sum(widths for widths, _ in fits),
            errors=sum(errors for _, errors in fits),
            both=sum(widths and errors for widths, errors in fits),
            readings=len(fits),
        )
        for (high, fits), (fdm, akf) in zip(by_edge(chawda).items(), closed, strict=True)
    ]


def common_gains(chawda: Chawda, reading: int = rigs.MAIN) -> dict[str, list[float]]:
    """Return by which share FOAW's mean fidelity error is below that of FDM+filter and of AKF (0.1: 10 % lower).

    The key is the name of the other estimator; its list has one share per measurement. Means are over the walls that
    are passive with all three estimators in every measurement; without such a wall the mapping is empty.
    """
    numbers = {name: rigs.ESTIMATORS.index(name) for name in rigs.FILTERS}
    common = chawda.map.common(reading, list(numbers.values()))
    if not common.any():
        return {}
    mean = {
        name: [float(np.mean(of[common])) for of in chawda.map.fidelity[:, reading, number]]
        for name, number in numbers.items()
    }
    return {
        name: [1.0 - foaw / other for foaw, other in zip(mean[rigs.FOAW], mean[name], strict=True)]
        for name in (rigs.FDM, rigs.AKF)
    }


def common_gains_by_edge(chawda: Chawda) -> dict[float, dict[str, list[float]]]:
    """Return by which share FOAW's fidelity error is below that of FDM+filter and of AKF, by upper band edge (Hz)."""
    main = rigs.READINGS[rigs.MAIN]
    return {
        high: common_gains(chawda, rigs.READINGS.index(replace(main, high_hz=high)))
        for high in rigs.HIGHEST_HZ
    }


def common_error(chawda: Chawda, name: str) -> Spread:
    """Return the mean fidelity error (N·s/m) of one filter at the walls that are passive with all three filters.

    The result has mean and standard deviation over the measurements; its count is 0 for Levant's differentiator.
    """
    held = chawda.map.common(rigs.MAIN, [rigs.ESTIMATORS.index(one) for one in rigs.FILTERS])
    of = chawda.map.fidelity[:, rigs.MAIN, rigs.ESTIMATORS.index(name)]
    return Spread.of([float(one[held].mean()) for one in of] if held.any() and name in rigs.FILTERS else [])


def errors_of_quarters(chawda: Chawda) -> dict[str, tuple[float, float]]:
    """Return the mean fidelity errors (N·s/m) in the softest and in the stiffest quarter of the passive walls.

    The key is the name of the estimator; estimators with fewer than 4 passive walls are left out.
    """
    found = {}
    for number, name in enumerate(rigs.ESTIMATORS):
        held = chawda.map.common(rigs.MAIN, [number])
        if held.sum() < 4:
            continue
        errors = np.mean(chawda.map.fidelity[:, rigs.MAIN, number], axis=0)[held]
        stiffness = np.array(chawda.map.grid.stiffnesses)[np.nonzero(held)[1]]
        low, high = np.percentile(stiffness, (25.0, 75.0))
        found[name] = float(errors[stiffness <= low].mean()), float(errors[stiffness >= high].mean())
    return found


def larger_first(found: Readings) -> dict[str, tuple[int, int]]:
    """Count how often the first sampling scheme has a larger K-width (stiffest passive wall) than the second.

    The key is the allowed tolerance of the phase. A value is (results in which the first is larger, results in which
    the K-widths differ); there is one result for each frequency band and measurement.
    """
    counts: dict[str, tuple[int, int]] = {}
    for number, reading in enumerate(found.grid.readings):
        above, differ = counts.get(reading.allowed, (0, 0))
        for m in range(found.grid.measurements):
            first, second = (found.width(m, number, scheme).stiffness for scheme in (0, 1))
            above, differ = above + (first > second), differ + (first != second)
        counts[reading.allowed] = above, differ
    return counts


def at_softest_wall(chawda: Chawda) -> tuple[int, int]:
    """Return the number of maps whose largest fidelity error is at the softest wall, and the number of all maps.

    There is one map (all walls of a grid) for each estimator and measurement.
    """
    worst = [width.worst_stiffness for name in rigs.SCHEMES for width in chawda.widths(name)]
    return sum(k == chawda.map.grid.stiffnesses[0] for k in worst), len(worst)


def count_tuned(chawda: Chawda, name: str) -> int:
    """Return the number of numeric settings in the paper's sampling scheme for an estimator."""
    controller = rigs.SCHEMES[name].applied(chawda.map.grid.experiment).controller
    return len(tuned_numbers(controller.estimator, controller.parameters))


def is_capped(widths: Sequence[FrequencyWidth], name: str) -> bool:
    """Return True if the largest passive "stiffness" or "damping" (`name`) of a measurement is the grid's end."""
    return any(getattr(width, f"{name}_capped") for width in widths)


def variant_widths(chawda: Chawda) -> dict[str, FrequencyWidth]:
    """Return the largest passive stiffness and damping for each variant of Levant's differentiator, by its name."""
    return {name: chawda.variants.width(0, 0, n) for n, name in enumerate(chawda.variant_names)}


# --- dual-rate -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Ranked:
    """One sampling scheme on one of Koul's rigs, judged by one passivity test (band and tolerance).

    Area, stiffness and damping describe the passive region; each has mean and standard deviation over the measurements.
    """

    scheme: Scheme
    area: Spread
    stiffness: Spread
    damping: Spread
    error: Spread  # ratio of mean errors at walls passive with both; the dual-rate wall of Koul et al. is 1
    capped: bool  # whether the region reaches the stiffest walls of the grid


def rank_schemes(found: Readings, reading: int) -> list[Ranked]:
    """Return the sampling schemes of a grid, sorted by area of their passive region in the K–B plane, largest first.

    `reading` is the index of the passivity test.
    """
    schemes = found.grid.schemes
    reference = schemes.index(Scheme.parse(rigs.PAPERS_DUAL))
    rows = []
    for number, scheme in enumerate(schemes):
        widths = found.widths(reading, number)
        rows.append(
            Ranked(
                scheme,
                found.areas(reading, number),
                spread(widths, "stiffness"),
                spread(widths, "damping"),
                _relative_error(found, reading, number, reference),
                is_capped(widths, "stiffness"),
            )
        )
    return sorted(rows, key=lambda row: -row.area.mean)


def _relative_error(found: Readings, reading: int, number: int, reference: int) -> Spread:
    ratios = []
    for m in range(found.grid.measurements):
        held = connected(found.passive[m, reading, number]) & connected(found.passive[m, reading, reference])
        if held.any():
            error = found.fidelity[m, reading]
            ratios.append(float(error[number][held].mean() / error[reference][held].mean()))
    return Spread.of(ratios)


@dataclass(frozen=True, slots=True, kw_only=True)
class BestDual:
    """The dual-rate scheme with the largest passive area, and the schemes to compare it with.

    Attributes
    ----------
    near
        Other dual-rate schemes whose area differs from the best by at most the sum of both standard deviations.
    faithful
        The dual-rate scheme with the smallest fidelity error, relative to the paper's dual-rate wall; None if unknown.
    uniform
        The uniform-rate scheme with the largest area.
    """

    best: Ranked
    near: list[Ranked]
    faithful: Ranked | None
    uniform: Ranked
    ratio: float  # of the areas of the best one and of the best uniform one

    @classmethod
    def of(cls, rows: Sequence[Ranked]) -> BestDual:
        """Choose the best, near, most faithful and best uniform scheme from `rows`, sorted by area, largest first."""
        best, *others = (row for row in rows if row.scheme.kind == "dual")
        judged = [row for row in (best, *others) if row.error.count]
        uniform = max((row for row in rows if row.scheme.kind == "uniform"), key=lambda row: row.area.mean)
        return cls(
            best=best,
            near=[
                row
                for row in others
                if best.area.mean - row.area.mean <= _deviation(best.area) + _deviation(row.area)
            ],
            faithful=min(judged, key=lambda row: row.error.mean) if judged else None,
            uniform=uniform,
            ratio=over(best.area.mean, uniform.area.mean),
        )


def _deviation(found: Spread) -> float:
    return float(np.nan_to_num(found.deviation))
