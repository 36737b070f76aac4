"""Matrix exponential: the exact transition matrix of a linear system over a time.

Theory, experiments and simulated plants use it. It must not import scipy: `scipy.linalg.expm` takes 0.1 s to load,
which every simulated device would spend on one small matrix.
"""

import math

import numpy as np
from numpy.typing import NDArray

_TERMS = 14  # of a matrix of norm 1/2 at most: the next one is below the rounding of the first
_POWERS = (4, 5)  # 4·3 is less than the terms


def expm(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return exp(matrix) by scaling and squaring (Al-Mohy and Higham, SIAM J. Matrix Anal. Appl. 31, 2009)."""
    # From the norms of powers, not of the matrix itself: powers hardly depend on the units of the rows, and each
    # squaring costs precision.
    norm = max(np.linalg.norm(np.linalg.matrix_power(matrix, p), 1) ** (1 / p) for p in _POWERS)
    squarings = max(0, math.frexp(norm)[1] + 1)
    part = matrix / 2.0**squarings
    term = whole = np.eye(len(matrix))
    for k in range(1, _TERMS + 1):
        term = term @ part / k
        whole = whole + term
    for _ in range(squarings):
        whole = whole @ whole
    return whole
