"""Matrices of the Kalman filter on a chain of integrators, in counts and velocity periods (sample to sample).

It is used to design a filter, never in the loop: `rig.control.estimators._kalman` has the recursion in scalars. With
the period as the unit of time the transition matrix is [[1, 1, ½], [0, 1, 1], [0, 0, 1]], or its upper left block for
two integrators, and only the first state, the position, is measured.
"""

import math

import numpy as np

from rig.control.estimators.estimator import Floats
from rig.core.deferred import linalg
from rig.core.errors import ConfigError


def process_noise(order: int, *, printed: bool = False) -> Floats:
    """Return the covariance of one period's process noise for a unit intensity, in counts and periods.

    Parameters
    ----------
    order
        3 for white jerk, 2 for white acceleration.
    printed
        True: use the factorial (2n+1−i−j)! as printed in the paper (n = 3) instead of the integral's factor (2n+1−i−j).

    Returns
    -------
    ndarray, shape (order, order)
        ∫₀¹ exp(A·s)·G·Gᵀ·exp(Aᵀ·s) ds with G the last unit vector: 1/((n−i)!·(n−j)!·(2n+1−i−j)).

    Source: Chawda et al., after equation (4), corrected unless `printed`.
    """
    noise = np.empty((order, order))
    for i in range(1, order + 1):
        for j in range(1, order + 1):
            last = 2 * order + 1 - i - j
            factor = math.factorial(last) if printed else last
            noise[i - 1, j - 1] = 1.0 / (math.factorial(order - i) * math.factorial(order - j) * factor)
    return noise


def steady_gain(noise: Floats, r: float) -> Floats:
    """Return the gain to which the Kalman recursion converges, from the discrete algebraic Riccati equation.

    Parameters
    ----------
    noise
        Covariance of the process noise, counts and periods, shape (2, 2) or (3, 3).
    r
        Variance of the measurement, counts².

    Returns
    -------
    ndarray, shape (order,)
        Gains of position, velocity and, for order 3, acceleration, in counts and periods.

    Raises
    ------
    ConfigError
        scipy finds no solution. (Down to ω0·T = 1e-6 it finds one, with seven digits of the gain.)
    """
    order = len(noise)
    transition = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])[:order, :order]
    measured = np.eye(order)[:, :1]
    try:
        predicted = linalg.solve_discrete_are(transition.T, measured, noise, np.array([[r]]))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ConfigError(
            f"estimator kalman: a steady gain cannot be computed ({error})",
            remedy='choose a higher bandwidth or gain = "recursive"',
        ) from error
    return np.asarray(predicted[:, 0] / (predicted[0, 0] + r))
