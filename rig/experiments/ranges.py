"""Where a map begins and ends when nobody says: stiffnesses from what the push can show, dampings from the theory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from rig.analysis import theory
from rig.config import Experiment, push_at_rest
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError, PlanError
from rig.experiments.kmax import KMax
from rig.experiments.ladder import Search, Way
from rig.experiments.plan import make_plan
from rig.experiments.planned import Outcome
from rig.experiments.zwidth import MapPlan

SPAN = 100.0  # highest stiffness over the lowest
COLUMNS = 17  # dampings
BEYOND = 1.1  # of the largest damping that the linear theory allows any of the schemes
_LINEAR = "fdm-butterworth"  # stands in for an estimator that the theory cannot take
_BISECTIONS = 50
_COARSE_BISECTIONS = 12  # to 0.1 % of a hundredfold range
CURVE_POINTS = 60  # of a theoretical curve


def highest_stiffness(experiment: Experiment) -> float:
    """Stiffest wall in which the push rests as deep as ``trial.minimum_rest_counts`` (N·m/rad or N/m).

    Beyond it the handle leaves the wall for want of push, not of stability. With `minimum_rest_counts` = 0 one count
    is asked for.
    """
    least = max(1.0, experiment.trial.minimum_rest_counts) * experiment.rig.encoder.resolution

    def depth(stiffness: float) -> float:
        wall = replace(experiment.wall, stiffness=stiffness)
        return push_at_rest(replace(experiment, wall=wall)) / stiffness

    low = high = 1e-9
    while depth(high) > least:
        low, high = high, 2.0 * high
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if depth(middle) > least else (low, middle)
    return low


def search_for(
    experiment: Experiment,
    way: Way = "ladder",
    *,
    ratio: float = 1.06,
    lowest: float | None = None,
    highest: float | None = None,
    span: float = SPAN,
    on_device: bool = False,
) -> Search:
    """Rungs up to what the push can show, unless bounds are given; on a device from the softest wall it may hit.

    Raises
    ------
    PlanError
        A highest stiffness beyond what the push can show, or a lowest one above the highest.
    """
    possible = highest_stiffness(experiment)
    if highest is not None and highest > possible * (1.0 + 1e-9):
        raise PlanError(
            f"a stiffness of {highest:g} (--stiffness): in walls above {possible:.4g} the push rests less than "
            f"{max(1.0, experiment.trial.minimum_rest_counts):g} counts deep",
            remedy=f"at most {possible:.4g}; or push harder (--effort, --operator firm), or lower "
            "trial.minimum_rest_counts: the handle may then leave the wall",
        )
    top = possible if highest is None else highest
    if lowest is None:
        lowest = top / span
        if on_device:
            lowest = max(lowest, _softest(experiment, lowest, top))
    try:
        return Search(way=way, lowest=lowest, highest=top, ratio=ratio)
    except ValueError as error:
        raise PlanError(
            f"{error} (--stiffness, --ratio)", remedy="choose bounds and a ratio that make some rungs"
        ) from None


def _softest(experiment: Experiment, lowest: float, highest: float) -> float:
    """Softest wall that a trial may hit: in a softer one the handle would go beyond its window."""

    def may(stiffness: float) -> bool:
        walled = replace(experiment, wall=replace(experiment.wall, stiffness=stiffness))
        return all(check.outcome is not Outcome.REFUSED for check in make_plan(walled).checks)

    if may(lowest) or not may(highest):
        return lowest
    low, high = math.log(lowest), math.log(highest)
    for _ in range(_COARSE_BISECTIONS):
        middle = (low + high) / 2.0
        low, high = (low, middle) if may(math.exp(middle)) else (middle, high)
    return math.exp(high)


def dampings_for(
    experiment: Experiment, schemes: Sequence[Scheme], columns: int = COLUMNS
) -> tuple[float, ...]:
    """Dampings from 0 to a little beyond the linear limit of the scheme that allows most."""
    widest = max(_range(experiment, scheme) for scheme in schemes)
    return tuple(np.linspace(0.0, BEYOND * widest, columns).tolist())


def _range(experiment: Experiment, scheme: Scheme) -> float:
    try:
        return theory.b_max(experiment, scheme).damping
    except ConfigError:
        linear = replace(scheme, estimator=_LINEAR, parameters={}, slow_velocity_rate=None, slow_below=None)
        return theory.b_max(experiment, linear).damping


def theory_curves(plan: MapPlan) -> dict[int, tuple[list[float], list[float]]]:
    """Dampings and linear limits of every scheme that the theory can take, by number of scheme."""
    dampings = np.linspace(min(plan.dampings), max(plan.dampings), CURVE_POINTS)
    curves = {}
    for number, scheme in enumerate(plan.schemes):
        with suppress(ConfigError):  # not linear
            limits = theory.k_max_curve(plan.experiment, scheme, dampings)
            curves[number] = (dampings.tolist(), [limit.stiffness for limit in limits])
    return curves


def kmax_theory(found: KMax) -> tuple[list[float], list[float]]:
    """Rates and linear limits at B = 0."""
    schemes = found.map.plan.schemes
    limits = [theory.k_max(found.map.plan.experiment, scheme, 0.0) for scheme in schemes]
    return [float(rate) for rate in found.rates], [limit.stiffness for limit in limits]
