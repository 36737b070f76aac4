"""The grid of a frequency-domain map when nobody says one, and what linear theory expects of each scheme."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from rig import config
from rig.analysis import theory
from rig.analysis.impedance.ideal import rendered
from rig.analysis.impedance.signals import Floats
from rig.analysis.theory.loop import LinearLoop, linear_loop
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.experiments.excitation_run import Signal
from rig.experiments.impedance import Judging
from rig.experiments.zwidth_frequency import FrequencyPlan

SHARE = 0.4  # of what the linear theory calls stable: beyond that a measured map is speckle
STIFFNESSES, DAMPINGS = 60, 16
CURVE_POINTS = 24  # dampings of a theoretical curve
SCAN = 24  # stiffnesses of a scan for the passive ones
REFINEMENTS = 12  # of a step of the scan: to 0.001 % of the range
_REFERENCE = "fdm"  # an unfiltered difference: linear, and the same for all schemes of the same rates

PAPERS_ESTIMATORS = ("fdm-butterworth", "foaw-best", "kalman", "levant")
PAPERS_RATE = 1000
# The paper's estimators with its settings, section V: α = μ1·C = 6.6 and λ = μ2·√C = 2.45 with C = 6 m/s².
PAPERS_SCHEMES = (
    "uniform:1k,estimator=fdm-butterworth,cutoff_hz=499",
    "uniform:1k,estimator=foaw-best",
    "uniform:1k,estimator=kalman,q=25000,variance=paper,noise=printed",
    "uniform:1k,estimator=levant,discretisation=explicit,"
    f"gains=custom,lipschitz=6,mu1=1.1,mu2={2.45 / math.sqrt(6.0)!r}",
)


def frequency_plan(
    experiment: Experiment,
    schemes: Sequence[Scheme] = (),
    *,
    stiffnesses: Sequence[float] | None = None,
    dampings: Sequence[float] | None = None,
    judging: Judging | None = None,
    signal: Signal | None = None,
) -> FrequencyPlan:
    """A plan with everything said.

    Parameters
    ----------
    experiment
        Rig and excitation.
    schemes
        `default_schemes` if empty.
    stiffnesses, dampings
        Of the grid; `default_grid` if None.
    judging, signal
        As in `FrequencyPlan`. If nothing is said a rigid rig is measured by its encoder's counts and one of two masses
        by the true position of its handle, because an encoder on the other mass shows no driving-point impedance.

    Raises
    ------
    ConfigError, PlanError
        A scheme or a grid that cannot be.
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
    """The paper's four estimators: at 1 kHz with its settings, else with their defaults at the rates at hand."""
    rates = experiment.controller.position_rate, experiment.controller.velocity_rate
    if set(rates) == {PAPERS_RATE}:
        return tuple(Scheme.parse(text) for text in PAPERS_SCHEMES)
    return tuple(
        Scheme(position_rate=rates[0], velocity_rate=rates[1], estimator=name) for name in PAPERS_ESTIMATORS
    )


def default_grid(
    experiment: Experiment, schemes: Sequence[Scheme]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Evenly spaced stiffnesses and dampings: `SHARE` of what an unfiltered difference holds in the linear theory.

    Stiffness of its largest stable stiffness over all dampings, damping of the largest at the lowest stiffness, both of
    the rates that hold most, and rounded to two digits. The lowest stiffness is a step, not zero.
    """
    excited = config.excited(experiment)
    stiffness = damping = 0.0
    for scheme in {(s.position_rate, s.velocity_rate): s for s in schemes}.values():
        reference = replace(
            scheme, estimator=_REFERENCE, parameters={}, slow_velocity_rate=None, slow_below=None
        )
        widest = theory.b_max(excited, reference).damping
        limits = theory.k_max_curve(excited, reference, np.linspace(0.0, widest, CURVE_POINTS))
        damping = max(damping, widest)
        stiffness = max(stiffness, *(limit.stiffness for limit in limits))
    top, last = _two_digits(SHARE * stiffness), _two_digits(SHARE * damping)
    return (
        tuple(np.linspace(0.0, top, STIFFNESSES + 1)[1:].tolist()),
        tuple(np.linspace(0.0, last, DAMPINGS).tolist()),
    )


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


def linear_curves(
    plan: FrequencyPlan, points: int = CURVE_POINTS
) -> dict[int, tuple[list[float], list[float], list[float]]]:
    """Dampings, stable stiffness and passive stiffness of every scheme that the linear theory can take, by number.

    Passive is meant over the plan's band only, which lets through much that Colgate and Schenkel's condition (all
    frequencies) does not. Friction and quantum are left out.
    """
    dampings = np.linspace(plan.dampings[0], plan.dampings[-1], points)
    excited, curves = config.excited(plan.experiment), {}
    lines = _lines(plan)
    for number, scheme in enumerate(plan.schemes):
        with suppress(ConfigError):  # not linear
            loop = linear_loop(excited, scheme)
            stable = [limit.stiffness for limit in theory.k_max_curve(excited, scheme, dampings)]
            passive = [passive_limit(loop, float(b), k, lines) for b, k in zip(dampings, stable, strict=True)]
            curves[number] = (dampings.tolist(), stable, passive)
    return curves


def passive_limit(loop: LinearLoop, damping: float, highest: float, lines_hz: Floats) -> float:
    """Largest stiffness up to which the closed form has no negative real part at these lines; `highest` at most."""

    def holds(stiffness: float) -> bool:
        return bool((rendered(loop, stiffness, damping, lines_hz).real >= 0.0).all())

    low = high = 0.0
    for stiffness in np.linspace(0.0, highest, SCAN + 1)[1:]:
        low, high = high, float(stiffness)
        if not holds(high):
            break
    else:
        return highest
    for _ in range(REFINEMENTS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _lines(plan: FrequencyPlan) -> Floats:
    low, high = plan.band_hz
    period_s = plan.experiment.excitation.period_s
    lines = np.arange(math.ceil(low * period_s - 1e-6), math.floor(high * period_s + 1e-6) + 1) / period_s
    below = lines[lines < 0.5 * min(scheme.velocity_rate for scheme in plan.schemes) * (1.0 - 1e-9)]
    return np.asarray(below, dtype=np.float64)
