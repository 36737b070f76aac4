"""Gains of an observer on two or three integrators that place the poles of its estimation error.

`tracking` and `disturbance` are designed with it; in the loop both are the steady recursion of
`rig.control.estimators._kalman` with these gains. All numbers are in counts and velocity periods.
"""

import cmath
from collections.abc import Sequence

import numpy as np


def gains(poles: Sequence[complex]) -> list[float]:
    """Return the observer gains that place the poles of the estimation error.

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
