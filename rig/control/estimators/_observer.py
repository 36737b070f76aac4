"""A Luenberger observer of position, velocity and disturbance, with the motor's effort as an optional input.

The estimators `tracking` and `disturbance` use it with different gains, which place the poles of the estimation error.
It computes in counts and velocity periods. The steady Kalman filter on integrators is the same recursion with other
gains.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

import numpy as np

from rig.control.estimators._fdm import count_difference
from rig.control.estimators.estimator import COMMON, OWN_INTS, PERIOD, RESOLUTION, WINDOW, Floats, Ints
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

GAIN1, GAIN2, GAIN3, INPUT = range(
    COMMON, COMMON + 4
)  # parameters; INPUT: counts per period² per unit of effort
OFFSET, VELOCITY, DISTURBANCE = range(3)  # state_f: position less the last count; disturbance as acceleration
STARTED, PREVIOUS = range(OWN_INTS, OWN_INTS + 2)  # state_i
FLOATS, INTS = 3, OWN_INTS + 2
LONGEST_GAP = 1000  # periods; after a longer one it restarts on the mean slope


@kernel(ESTIMATOR_SIGNATURE, no_refcount=True)
def update(
    count: int,
    edge_age_s: float,
    elapsed_ticks: int,
    effort: float,
    state_f: Floats,
    state_i: Ints,
    parameters: Floats,
) -> float:
    """Return the velocity (rad/s or m/s); zero for the first sample. A gap is predicted, then corrected once."""
    scale = parameters[RESOLUTION] / parameters[PERIOD]
    moved = count_difference(count, state_i[PREVIOUS])
    state_i[PREVIOUS] = count
    if state_i[STARTED] == 0:
        state_i[STARTED] = 1
        return 0.0
    state_i[WINDOW] = elapsed_ticks
    if elapsed_ticks > LONGEST_GAP:
        state_f[OFFSET], state_f[DISTURBANCE] = 0.0, 0.0
        state_f[VELOCITY] = moved / elapsed_ticks
        return float(state_f[VELOCITY] * scale)
    offset, velocity = state_f[OFFSET], state_f[VELOCITY]
    acceleration = state_f[DISTURBANCE] + parameters[INPUT] * effort
    for _ in range(elapsed_ticks):
        offset += velocity + 0.5 * acceleration
        velocity += acceleration
    innovation = moved - offset
    velocity += parameters[GAIN2] * innovation
    # Less the newest count, so that large counts cost no digits.
    state_f[OFFSET] = (parameters[GAIN1] - 1.0) * innovation
    state_f[VELOCITY] = velocity
    state_f[DISTURBANCE] += parameters[GAIN3] * innovation
    return float(velocity * scale)


def check_frequency(name: str, frequency_hz: float, period_s: float) -> None:
    """Raise `ConfigError` for a natural frequency at or above Nyquist."""
    if frequency_hz >= 0.5 / period_s:
        raise ConfigError(
            f"estimator {name}: frequency_hz = {frequency_hz:g} Hz is not below Nyquist {0.5 / period_s:g} Hz",
            remedy="choose a lower frequency_hz, or raise velocity_rate",
        )


def gains(poles: Sequence[complex]) -> list[float]:
    """Return the gains that place the poles of the estimation error.

    Parameters
    ----------
    poles
        s·T of two or three continuous poles, conjugate poles as pairs; they are mapped to z = exp(s·T).

    Returns
    -------
    list of float
        Gains of position, velocity and disturbance, in counts and periods; the third is zero for two poles.

    Source: Ackermann's formula for the error after the correction, (I − L·H)·F with H = (1, 0, 0).
    """
    order = len(poles)
    transition = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])[:order, :order]
    output = transition[0]
    observability = np.array([output @ np.linalg.matrix_power(transition, k) for k in range(order)])
    wanted = np.eye(order, dtype=complex)
    # Factors F − z·I with 1 − z free of cancellation: at a thousandth of the rate the product of three such numbers is
    # 1e-9, which a polynomial in powers of F would lose in rounding.
    for pole in poles:
        wanted = wanted @ (transition - np.eye(order) + _one_minus_exp(pole) * np.eye(order))
    last = np.zeros(order)
    last[-1] = 1.0
    found = np.real(wanted) @ np.linalg.solve(observability, last)
    return [*found.tolist(), 0.0][:3]


def _one_minus_exp(pole: complex) -> complex:
    """Return 1 − exp(pole) without cancellation, as −2·exp(pole/2)·sinh(pole/2)."""
    return -2.0 * cmath.exp(0.5 * pole) * cmath.sinh(0.5 * pole)


def turn(frequency_hz: float, period_s: float) -> float:
    """Return ω0·T (rad), the angle of a natural frequency in one velocity period."""
    return 2.0 * math.pi * frequency_hz * period_s
