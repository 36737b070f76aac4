"""Compute noise, fidelity and cost of a velocity estimate (estimator, rates, prediction, delay and lag).

`_linear` calls this module for every candidate. It must not depend on a wall.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rig.config import Controller
from rig.control import estimators
from rig.firmware.tick_budget import named_budget

# Amplitude of the test sines (counts), so large that quantisation hardly changes the response.
AMPLITUDE = 32.0
SAMPLES = 2048
# Number of periods of each test sine in SAMPLES samples.
PERIODS = tuple(int(n) for n in np.unique(np.geomspace(2, SAMPLES // 5, 24).round()))
# Limit of |D − 1|, where D is rendered over true velocity: a phase error of 29°, or half of the velocity missing.
ERROR = 0.5
SEED = 0

Complex = NDArray[np.complex128]


def noise(controller: Controller, resolution: float) -> float:
    """Return the rms of the estimated velocity at rest, while the count toggles at random (rad/s or m/s)."""
    # The handle rests at the boundary of two counts, and the count toggles at random in each sample: the worst case at
    # rest, and equal for all estimators.
    toggling = np.random.default_rng(SEED).integers(0, 2, 2 * SAMPLES)
    velocity = _velocity(controller, toggling, resolution)[SAMPLES:]
    return float(np.sqrt(np.mean(np.square(velocity))))


def fidelity_hz(controller: Controller, resolution: float, lag_s: float, delay_ticks: int) -> float:
    """Return the frequency (Hz) up to which the rendered velocity differs from the true one by at most half of it.

    `lag_s` is the amplifier's lag (s), `delay_ticks` the delay from a sample to its effort (ticks).
    """
    period_s = 1.0 / controller.velocity_rate
    frequency = np.array(PERIODS) / (SAMPLES * period_s)
    omega = 2.0 * np.pi * frequency
    late_s = delay_ticks / controller.position_rate
    rendered = (
        _respond_to_sines(controller, resolution)
        * _respond_to_hold(omega * period_s, controller.prediction == "extrapolate")
        * np.exp(-1j * omega * late_s)
        / (1.0 + 1j * omega * lag_s)
    )
    error = np.abs(rendered - 1.0)
    beyond = np.flatnonzero(error > ERROR)
    if not len(beyond):
        return float(frequency[-1])
    first = int(beyond[0])
    if first == 0:
        return 0.0
    share = (ERROR - error[first - 1]) / (error[first] - error[first - 1])
    return float(frequency[first - 1] * (frequency[first] / frequency[first - 1]) ** share)


def cost(controller: Controller, board: str) -> float | None:
    """Return the estimator's mean processor cycles per tick on a board; None if the board cannot run the estimator."""
    # Only the estimator's longest call, spread over the ticks of a velocity period: the other work is equal for all.
    of_a_call = _budget(board).call_cycles(controller.estimator)
    return None if of_a_call is None else of_a_call * controller.velocity_rate / controller.position_rate


def fits_a_tick(controller: Controller, board: str) -> bool:
    """Return True if the board's processor can compute the control law within a tick at the position rate."""
    return controller.position_rate <= _budget(board).rate_maximum(controller.estimator)


_budget = lru_cache(named_budget)


def _velocity(controller: Controller, counts: NDArray[np.int64], resolution: float) -> NDArray[np.float64]:
    return estimators.estimate(
        controller.estimator,
        counts,
        1.0 / controller.velocity_rate,
        resolution=resolution,
        **controller.parameters,
    )


def _respond_to_sines(controller: Controller, resolution: float) -> Complex:
    """Return the complex ratio of estimated to true velocity for the test sines, by ascending frequency."""
    settings = tuple(sorted(controller.parameters.items()))
    return _of_estimator(controller.estimator, settings, controller.velocity_rate, resolution)


@lru_cache(maxsize=64)
def _of_estimator(
    name: str, settings: tuple[tuple[str, float | str], ...], rate: int, resolution: float
) -> Complex:
    found = []
    for periods in PERIODS:
        phase = 2.0 * np.pi * periods * np.arange(2 * SAMPLES) / SAMPLES
        counts = estimators.quantise(AMPLITUDE * resolution * np.sin(phase), resolution)
        velocity = estimators.estimate(name, counts, 1.0 / rate, resolution=resolution, **dict(settings))
        wave = np.exp(-1j * phase[SAMPLES:])
        true = AMPLITUDE * resolution * 2.0 * np.pi * periods * rate / SAMPLES  # amplitude of a cosine
        found.append(2.0 / SAMPLES * (velocity[SAMPLES:] @ wave) / true)
    return np.array(found)


def _respond_to_hold(turn: NDArray[np.float64], extrapolate: bool) -> Complex:
    """Return the response (complex) of a hold or linear extrapolation to sines of `turn` (rad) per sampling period."""
    zero = (1.0 - np.exp(-1j * turn)) / (1j * turn)
    return np.asarray((1.0 + 1j * turn) * zero**2 if extrapolate else zero)
