"""Compute the velocity that the estimator outputs for given encoder counts, for comparison with the speed limit.

One count gives a pulse of the estimated velocity, whose integral is the travel of one count. With a fast filter and a
coarse encoder, the peak of this pulse can exceed any real speed of the handle.

Plans, predictions of `rig.doctor`, maps, identification and `rig.experiments.new_rig` call it. It must not simulate a
run or read a recording.
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rig.config._derive import settings_of_rig
from rig.config._sections import Experiment
from rig.control import estimators

# Samples at rest before a count and after it: longer than any filter of an estimator.
BEFORE, AFTER = 256, 4096
# Of a steady motion that is read: so many counts; samples, from and to.
RAMP_COUNTS, RAMP_SAMPLES = 64, (64, 1 << 14)
CUTOFF = "cutoff_hz"
# What one count reads as behind a second-order Butterworth filter, over its cut-off: at most 0.46·2π.
COUNT_PEAK = 2.9
# Of the described cut-off, below which none is named; the steps of the search.
LEAST_CUTOFF, BISECTIONS = 1e-3, 14

Settings = tuple[tuple[str, float | str], ...]


def pulse_of_count(experiment: Experiment) -> NDArray[np.float64]:
    """Return the estimated velocity (rad/s or m/s) in the velocity samples around a single encoder count."""
    own = experiment.controller
    return _pulse(
        own.estimator, _settings(experiment), own.velocity_rate, abs(experiment.rig.encoder.resolution)
    )


def highest_reading(experiment: Experiment, velocity: float = 0.0) -> float:
    """Return the highest estimated speed (rad/s or m/s) while the handle moves at a steady velocity (rad/s or m/s).

    The result is at least the peak for a single count, however slowly the handle moves; ∞ if the estimator diverges.
    """
    own = experiment.controller
    ahead = own.position_rate // own.velocity_rate - 1 if own.prediction == "extrapolate" else 0
    resolution = abs(experiment.rig.encoder.resolution)
    return _peak(own.estimator, _settings(experiment), own.velocity_rate, resolution, abs(velocity), ahead)


def quiet_cutoff(experiment: Experiment, most: float) -> float | None:
    """Return the highest cut-off (Hz) at which one encoder count causes a velocity estimate of at most `most`.

    `most` is in rad/s or m/s. The result is not above the present cut-off; None without a cut-off, or if none is quiet.
    """
    own = experiment.controller
    cutoff = own.parameters.get(CUTOFF)
    if not isinstance(cutoff, float | int):
        return None
    low, high = LEAST_CUTOFF, 1.0
    for _ in range(BISECTIONS):
        middle = math.sqrt(low * high)
        filtered = replace(own, parameters={**own.parameters, CUTOFF: middle * cutoff})
        quiet = highest_reading(replace(experiment, controller=filtered)) <= most
        low, high = (middle, high) if quiet else (low, middle)
    return low * cutoff if low > LEAST_CUTOFF else None


def _settings(experiment: Experiment) -> Settings:
    own = experiment.controller
    of_rig = estimators.get(own.estimator).settings_of(settings_of_rig(experiment))
    return tuple(sorted({**of_rig, **own.parameters}.items()))


@lru_cache(maxsize=4096)
def _peak(name: str, settings: Settings, rate: int, delta: float, velocity: float, ahead: int) -> float:
    """Return the highest estimated speed (rad/s or m/s), of a single encoder count or of a motion at `velocity`.

    `delta` is the travel per count (rad or m), `ahead` the number of ticks over which the velocity is extrapolated.
    """
    read = [_pulse(name, settings, rate, delta)]
    if velocity > 0.0:
        samples = int(np.clip(RAMP_COUNTS * delta * rate / velocity, *RAMP_SAMPLES))
        counts = estimators.quantise(velocity / rate * np.arange(AFTER + samples), delta)
        read.append(_estimate(name, settings, rate, delta, counts)[AFTER:])
    share = ahead / (ahead + 1)
    with np.errstate(over="ignore", invalid="ignore"):  # an estimator that diverges overflows: ∞ - ∞ is NaN
        speeds = [np.abs(each[1:] + share * np.diff(each)) for each in read]
    return max(float(np.where(np.isnan(one), math.inf, one).max(initial=0.0)) for one in speeds)


@lru_cache(maxsize=512)
def _pulse(name: str, settings: Settings, rate: int, delta: float) -> NDArray[np.float64]:
    return _estimate(name, settings, rate, delta, np.repeat([0, 1], [BEFORE, AFTER]))


def _estimate(
    name: str, settings: Settings, rate: int, delta: float, counts: NDArray[np.int64]
) -> NDArray[np.float64]:
    no_effort = np.zeros(len(counts))
    return estimators.estimate(name, counts, 1.0 / rate, resolution=delta, effort=no_effort, **dict(settings))
