"""Choose default ranges of a map of walls, and compute the limits by linear theory for each of its sampling schemes.

Commands, pages and papers call this module through `rig.experiments.mapping.interface`.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

import numpy as np

from rig import config
from rig.analysis import theory
from rig.analysis.impedance import Floats, walls
from rig.analysis.theory import LinearLoop, linear_loop
from rig.config import Experiment, push_at_rest
from rig.config.schemes import STAND_IN, Scheme
from rig.core.errors import ConfigError, PlanError
from rig.experiments.mapping._kmax import KMax, undamped_schemes
from rig.experiments.mapping._searches import StiffnessSearch, Way
from rig.experiments.mapping.impedance import Judging
from rig.experiments.mapping.zwidth import OFFSETS, Judged, MapPlan
from rig.experiments.mapping.zwidth_frequency import FrequencyPlan
from rig.experiments.trials.excitation_run import Signal
from rig.experiments.trials.plan import make_plan, predict_impact

T = TypeVar("T")

# Highest over lowest tested stiffness, at least.
SPAN = 100.0
# The lowest tested stiffness is the linear limit without damping divided by this, because quantisation lowers a limit.
BELOW = 4.0
COLUMNS = 17  # dampings
# Largest tested damping over the largest damping that linear theory permits for any scheme.
BEYOND = 1.1
CURVE_POINTS = 60  # points of a theoretical curve
_BISECTIONS = 50
_COARSE_BISECTIONS = 12  # to 0.1 % of a hundredfold range

# Largest grid values as a fraction of the stable limits of linear theory: above it a measured map of impedances is an
# irregular mixture of passive and other walls.
SHARE = 0.4
STIFFNESSES, DAMPINGS = 60, 16
FREQUENCY_POINTS = 24  # dampings of a theoretical curve
# Stiffnesses of the scan for the first wall that is not passive, bisections of its last step (0.001 % of the range).
SCAN, REFINEMENTS = 24, 12
_REFERENCE = "fdm"  # an unfiltered difference: linear, and the same for all schemes of the same rates

PAPERS_ESTIMATORS = ("fdm-butterworth", "foaw-best", "kalman", "levant")
PAPERS_RATE = 1000
# The estimators of Chawda et al. with their settings, section V: α = μ1·C = 6.6 and λ = μ2·√C = 2.45 with C = 6 m/s².
PAPERS_SCHEMES = (
    "uniform:1k,estimator=fdm-butterworth,cutoff_hz=499",
    "uniform:1k,estimator=foaw-best",
    "uniform:1k,estimator=kalman,q=25000,variance=paper,noise=printed",
    "uniform:1k,estimator=levant,discretisation=explicit,"
    f"gains=custom,lipschitz=6,mu1=1.1,mu2={2.45 / math.sqrt(6.0)!r}",
)


def bisect(holds: Callable[[float], bool], low: float, high: float, steps: int) -> tuple[float, float]:
    """Bisect between `low`, where `holds` is True, and `high`, where it is False; return the last two bounds."""
    for _ in range(steps):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low, high


# Hits -----------------------------------------------------------------------------------------------


def highest_stiffness(experiment: Experiment) -> float:
    """Return the stiffest wall (N·m/rad or N/m) in which the push rests ``trial.minimum_rest_counts`` (or 1) deep."""
    # In a stiffer wall the handle may leave the wall because the push is too weak, not because the wall is unstable.
    least = max(1.0, experiment.trial.minimum_rest_counts) * experiment.rig.encoder.resolution

    def rests(stiffness: float) -> bool:
        wall = replace(experiment.wall, stiffness=stiffness)
        return push_at_rest(replace(experiment, wall=wall)) / stiffness > least

    # Doubled until the push no longer rests deep enough: no upper bound is known beforehand.
    low = high = 1e-9
    while rests(high):
        low, high = high, 2.0 * high
    return bisect(rests, low, high, _BISECTIONS)[0]


def search_for(
    experiment: Experiment,
    way: Way = "ladder",
    *,
    ratio: float = 1.06,
    lowest: float | None = None,
    highest: float | None = None,
    span: float = SPAN,
    schemes: Sequence[Scheme] = (),
    on_device: bool = False,
) -> StiffnessSearch:
    """Return a search for the stiffness limit between `lowest` and `highest` (N·m/rad or N/m), with default bounds.

    By default `highest` is `highest_stiffness`, and `lowest` is `highest`/`span` or less: down to a fourth of the
    lowest limit that linear theory gives at B = 0 for the sampling schemes (if empty, the experiment's), while the
    handle stays within its window. On a device `lowest` is at least the softest wall that may be hit. `way` is the
    search's method, `ratio` the ratio of two tested stiffnesses.

    Raises
    ------
    PlanError
        `highest` exceeds `highest_stiffness`, or the bounds and the ratio are invalid.
    """
    possible = highest_stiffness(experiment)
    if highest is not None and highest > possible * (1.0 + 1e-9):
        raise PlanError(
            f"a stiffness of {highest:g} (`stiffness`) is too high: in walls above {possible:.4g} the "
            f"push comes to rest less than {max(1.0, experiment.trial.minimum_rest_counts):g} counts "
            "deep",
            remedy=f"choose at most {possible:.4g}; or push harder (`effort`, `operator` firm), or lower "
            "trial.minimum_rest_counts: the handle may then leave the wall",
        )
    top = possible if highest is None else highest
    if lowest is None:
        lowest = top / span
        below = _lowest_undamped_limit(experiment, schemes) / BELOW
        if 0.0 < below < lowest and ratio > 1.0:  # else StiffnessSearch raises below
            # In a softer wall the handle may leave its window, and the search would end at a false limit.
            while lowest > below and _stays_in_window(experiment, lowest / ratio):
                lowest /= ratio
        if on_device:
            lowest = max(lowest, _softest_allowed(experiment, lowest, top))
        else:  # with a coarse encoder even stiff walls may let the handle leave its window
            while ratio > 1.0 and 0.0 < lowest * ratio <= top and not _stays_in_window(experiment, lowest):
                lowest *= ratio
    try:
        return StiffnessSearch(way=way, lowest=lowest, highest=top, ratio=ratio)
    except ValueError as error:
        raise PlanError(
            f"{error} (`stiffness`, `ratio`)",
            remedy="choose bounds and a ratio that give at least two stiffnesses",
        ) from None


def _lowest_undamped_limit(experiment: Experiment, schemes: Sequence[Scheme]) -> float:
    """Return the lowest K (SI) at B = 0 at which linear theory finds a scheme unstable; inf for a drive's own wall."""
    if experiment.controller.wall_is_elsewhere:
        return math.inf
    experiment = theory.with_linear_wall(experiment)
    one_of_each_rate = {
        scheme.position_rate: scheme for scheme in schemes or theory.default_schemes(experiment)
    }
    return min(
        theory.k_max(experiment, replace(_with_estimator(scheme, _REFERENCE), prediction=None)).stiffness
        for scheme in one_of_each_rate.values()
    )


def _stays_in_window(experiment: Experiment, stiffness: float) -> bool:
    wall, limits = replace(experiment.wall, stiffness=stiffness), experiment.rig.limits
    deepest = predict_impact(replace(experiment, wall=wall)).peak_penetration
    return limits.position_minimum <= wall.position + wall.side * deepest <= limits.position_maximum


def _softest_allowed(experiment: Experiment, lowest: float, highest: float) -> float:
    """Return the lowest stiffness (SI) that a trial may hit; in softer walls the handle would leave its window."""

    def refused(logarithm: float) -> bool:
        walled = replace(experiment, wall=replace(experiment.wall, stiffness=math.exp(logarithm)))
        return not make_plan(walled).ok

    low, high = math.log(lowest), math.log(highest)
    if not refused(low) or refused(high):
        return lowest
    return math.exp(bisect(refused, low, high, _COARSE_BISECTIONS)[1])


def schemes_for(
    experiment: Experiment,
    schemes: Sequence[Scheme] = (),
    dampings: Sequence[float] | None = None,
    *,
    on_device: bool = False,
) -> tuple[Scheme, ...]:
    """Return the sampling schemes of a map of stable walls: `schemes`, or the experiment's and uniform ones.

    The uniform schemes have the experiment's rates; in a simulation with B = 0 only, rates from 100 Hz to 50 kHz.
    """
    if schemes:
        return tuple(schemes)
    if not on_device and dampings is not None and tuple(dampings) == (0.0,):
        # Without damping the velocity rate has no effect.
        return undamped_schemes()
    return tuple(theory.default_schemes(experiment))


def dampings_for(
    experiment: Experiment, schemes: Sequence[Scheme], columns: int = COLUMNS
) -> tuple[float, ...]:
    """Return `columns` equally spaced dampings (SI) from 0 to 1.1 times the largest one that theory finds stable."""
    widest = max(_damping_range(experiment, scheme) for scheme in schemes)
    return tuple(np.linspace(0.0, BEYOND * widest, columns).tolist())


def _damping_range(experiment: Experiment, scheme: Scheme) -> float:
    experiment = theory.with_linear_wall(experiment)
    try:
        return theory.damping_range(experiment, scheme)
    except ConfigError:
        # Linear theory does not cover a nonlinear estimator: use a finite difference with a filter in its place.
        return theory.damping_range(experiment, _with_estimator(scheme, STAND_IN))


def _with_estimator(scheme: Scheme, estimator: str) -> Scheme:
    return replace(scheme, estimator=estimator, parameters={}, slow_velocity_rate=None, slow_below=None)


def hit_plan(
    experiment: Experiment,
    schemes: Sequence[Scheme] = (),
    *,
    dampings: Sequence[float] | None = None,
    search: StiffnessSearch | None = None,
    offsets: Sequence[float] | None = None,
    repeats: int = 1,
    judged: Judged | None = None,
    on_device: bool = False,
) -> MapPlan:
    """Return the plan of a map of walls tested by hits, with defaults for settings that are not given.

    Parameters
    ----------
    experiment
        Rig, trial and thresholds.
    schemes
        Sampling schemes; if empty, the experiment's and uniform ones at its rates.
    dampings, search
        Dampings (N·m·s/rad or N·s/m) and search for the stiffness; None: by linear theory and the push.
    offsets
        Distances of position zero from the lower edge of its encoder cell (counts, 0 to below 1). None:
        `rig.experiments.mapping.zwidth.OFFSETS`, or the rig's only offset on a device.
    repeats
        Number of searches for each scheme, damping and encoder offset.
    judged
        Signals that are judged, ``"recorded"`` or ``"true"``; recorded if None.
    on_device
        True if the map of stable walls is measured on a device.

    Raises
    ------
    ConfigError, PlanError
        A scheme or a range is invalid.
    """
    chosen = schemes_for(experiment, schemes, dampings, on_device=on_device)
    if offsets is None:
        offsets = (experiment.rig.encoder.offset,) if on_device else OFFSETS
    return MapPlan(
        experiment=experiment,
        schemes=chosen,
        dampings=dampings_for(experiment, chosen) if dampings is None else tuple(dampings),
        search=search or search_for(experiment, schemes=chosen, on_device=on_device),
        offsets=tuple(offsets),
        repeats=repeats,
        judged=judged or "recorded",
    )


def theory_curves(plan: MapPlan) -> dict[int, tuple[list[float], list[float]]]:
    """Return dampings and largest stable K by theory (SI) for each linear scheme, by the scheme's index."""
    if plan.experiment.controller.wall_is_elsewhere:
        return {}
    dampings = np.linspace(min(plan.dampings), max(plan.dampings), CURVE_POINTS)
    return _linear_only(
        plan.schemes,
        lambda scheme: (
            dampings.tolist(),
            [limit.stiffness for limit in theory.k_max_curve(plan.experiment, scheme, dampings)],
        ),
    )


def _linear_only(schemes: Iterable[Scheme], curves_of: Callable[[Scheme], T]) -> dict[int, T]:
    curves = {}
    for number, scheme in enumerate(schemes):
        with suppress(ConfigError):  # not linear
            curves[number] = curves_of(scheme)
    return curves


def kmax_theory(found: KMax) -> tuple[list[float], list[float]]:
    """Return the rates (Hz) of the linear sampling schemes, and their largest stable K at B = 0 (N·m/rad or N/m)."""
    plan = found.map.plan
    limits = _linear_only(plan.schemes, lambda scheme: theory.k_max(plan.experiment, scheme, 0.0).stiffness)
    return [float(found.rates[number]) for number in limits], list(limits.values())


# Impedances -----------------------------------------------------------------------------------------


def frequency_plan(
    experiment: Experiment,
    schemes: Sequence[Scheme] = (),
    *,
    stiffnesses: Sequence[float] | None = None,
    dampings: Sequence[float] | None = None,
    judging: Judging | None = None,
    signal: Signal | None = None,
) -> FrequencyPlan:
    """Return the plan of a map of impedances, with defaults for settings that are not given.

    Parameters
    ----------
    experiment
        Rig and excitation.
    schemes
        Sampling schemes; if empty, those with the four estimators of Chawda et al.
    stiffnesses, dampings
        Values of the grid (N·m/rad or N/m, N·m·s/rad or N·s/m); None: up to 40 % of the limits of linear theory.
    judging, signal
        Thresholds of the verdict, and measured position ("count" or "truth"). Without `signal` a rigid rig is measured
        by encoder counts, and a rig of two masses by the true position of the handle, because the excitation acts on
        the handle, not at the encoder.

    Raises
    ------
    ConfigError, PlanError
        A scheme or a grid is invalid.
    """
    chosen = tuple(schemes) or default_schemes(experiment)
    if stiffnesses is None or dampings is None:
        k, b = default_grid(experiment, chosen)
        stiffnesses = k if stiffnesses is None else stiffnesses
        dampings = b if dampings is None else dampings
    if signal is None:
        signal = "count" if experiment.rig.mechanics.structure == "rigid" else "truth"
    return FrequencyPlan(
        experiment=experiment,
        schemes=chosen,
        stiffnesses=tuple(float(value) for value in stiffnesses),
        dampings=tuple(float(value) for value in dampings),
        judging=judging or Judging(),
        signal=signal,
    )


def default_schemes(experiment: Experiment) -> tuple[Scheme, ...]:
    """Return sampling schemes with the four estimators of Chawda et al., at the experiment's rates.

    At 1 kHz the estimators have the settings of the paper, at other rates their default settings.
    """
    rates = experiment.controller.position_rate, experiment.controller.velocity_rate
    if set(rates) == {PAPERS_RATE}:
        return tuple(Scheme.parse(text) for text in PAPERS_SCHEMES)
    return tuple(
        Scheme(position_rate=rates[0], velocity_rate=rates[1], estimator=name) for name in PAPERS_ESTIMATORS
    )


def default_grid(
    experiment: Experiment, schemes: Sequence[Scheme]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return evenly spaced stiffnesses and dampings (SI units), up to 40 % of the limits of linear theory.

    The limits are the largest stable stiffness and damping, with an unfiltered difference as estimator and the best of
    the schemes' rates. The ends are rounded to two digits. Stiffnesses do not include zero.
    """
    excited = theory.with_linear_wall(config.excited(experiment))
    stiffness = damping = 0.0
    for scheme in {(s.position_rate, s.velocity_rate): s for s in schemes}.values():
        loop = theory.as_lifted(excited, _with_estimator(scheme, _REFERENCE))
        widest = theory.damping_range(loop)
        limits = theory.k_max_curve(loop, None, np.linspace(0.0, widest, FREQUENCY_POINTS))
        damping = max(damping, widest)
        stiffness = max(stiffness, *(limit.stiffness for limit in limits))
    top, last = (float(f"{SHARE * value:.2g}") for value in (stiffness, damping))
    return (
        tuple(np.linspace(0.0, top, STIFFNESSES + 1)[1:].tolist()),
        tuple(np.linspace(0.0, last, DAMPINGS).tolist()),
    )


def linear_curves(
    plan: FrequencyPlan, points: int = FREQUENCY_POINTS
) -> dict[int, tuple[list[float], list[float], list[float]]]:
    """Return by index of the sampling scheme lists of damping, largest stable K and largest passive K by theory (SI).

    Schemes with a nonlinear estimator are left out. A wall counts as passive if it is passive within the plan's band;
    the condition of Colgate and Schenkel (all frequencies) is stricter. Friction and quantisation are neglected.
    """
    dampings, lines = np.linspace(plan.dampings[0], plan.dampings[-1], points), _lines(plan)
    excited = config.excited(plan.experiment)

    def curves(scheme: Scheme) -> tuple[list[float], list[float], list[float]]:
        loop = linear_loop(excited, scheme)
        stable = [limit.stiffness for limit in theory.k_max_curve(excited, scheme, dampings)]
        passive = [passive_limit(loop, float(b), k, lines) for b, k in zip(dampings, stable, strict=True)]
        return dampings.tolist(), stable, passive

    return _linear_only(plan.schemes, curves)


def passive_limit(loop: LinearLoop, damping: float, highest: float, lines_hz: Floats) -> float:
    """Return the stiffness up to which linear theory predicts Re Z ≥ 0 at all these frequencies; at most `highest`.

    Stiffnesses are in N·m/rad or N/m, the damping in N·m·s/rad or N·s/m.
    """
    wall = walls(loop, lines_hz)

    def passive(stiffness: float) -> bool:
        return bool((wall(stiffness, damping).real >= 0.0).all())

    low = 0.0
    for stiffness in np.linspace(0.0, highest, SCAN + 1)[1:].tolist():
        if not passive(stiffness):
            return bisect(passive, low, stiffness, REFINEMENTS)[0]
        low = stiffness
    return highest


def _lines(plan: FrequencyPlan) -> Floats:
    low, high = plan.band_hz
    period_s = plan.experiment.excitation.period_s
    lines = np.arange(math.ceil(low * period_s - 1e-6), math.floor(high * period_s + 1e-6) + 1) / period_s
    below = lines[lines < 0.5 * min(scheme.velocity_rate for scheme in plan.schemes) * (1.0 - 1e-9)]
    return np.asarray(below, dtype=np.float64)
