"""Gains for which Levant's differentiator converges: sufficient regions of two proofs, and a computed region.

Gains are written without the Lipschitz constant C: α = μ1·C, λ = μ2·√C, so that the regions are the same for every rig
(Chawda et al., Fig. 1). Both proofs are conservative: the pair that Levant recommends lies in neither region.
`half_cycle_contraction` computes how fast the error contracts for a pair.

Source: Chawda et al., equations (10), (11), (14) and Fig. 1; the contraction is derived for this project.

The design of Levant's estimator and the reproduction of Chawda et al. use it. Nothing here runs an estimator or
simulates a rig.
"""

import math

import numpy as np

NAMED_GAINS: dict[str, tuple[float, float]] = {
    "hba-sc": (1.1, 1.0),  # Levant 1998, equation (11) of Chawda et al.
    "levant": (1.1, 1.5),  # Levant's later recommendation
}
LARGEST_MU2 = 100.0  # where the search for a boundary begins
_QUADRATURE = 4001  # directions; more change the contraction by less than 1e-6


def hba_mu1(mu2: float) -> float:
    """Return the least μ1 = α/C for which a homogeneity-based proof shows convergence at μ2; infinite for μ2 ≤ 2."""
    square = mu2 * mu2
    return (square + 4.0) / (square - 4.0) if mu2 > 2.0 else math.inf


def lfba_mu1(mu2: float) -> float:
    """Return the bound that μ1 = α/C must exceed so that a Lyapunov-based proof shows convergence at μ2."""
    return 3.0 + 2.0 / (mu2 * mu2) if mu2 > 0.0 else math.inf


def in_hba(mu1: float, mu2: float) -> bool:
    """Return True if Levant's gains satisfy the homogeneity-based proof: mu2 > 2 and mu1 ≥ `hba_mu1(mu2)`."""
    return mu2 > 2.0 and mu1 >= hba_mu1(mu2)


def in_lfba(mu1: float, mu2: float) -> bool:
    """Return True if Levant's gains satisfy the Lyapunov-based proof: mu1 > `lfba_mu1(mu2)`, mu2 > 0."""
    return mu2 > 0.0 and mu1 > lfba_mu1(mu2)


def find_crossing() -> tuple[float, float]:
    """Return (μ1, μ2) = (3.2656, 2.7443), where the regions of the homogeneity- and Lyapunov-based proof cross."""
    mu2 = math.sqrt((7.0 + math.sqrt(65.0)) / 2.0)
    return lfba_mu1(mu2), mu2


def half_cycle_contraction(mu1: float, mu2: float) -> float:
    """Return the worst-case factor by which a half cycle multiplies the velocity error x2 of Levant's differentiator.

    The worst case is over all disturbances |f̈| ≤ C. Below 1 the error of the continuous differentiator contracts for
    every such signal, and converges in finite time; 0 means that no disturbance can move the position error x1 across
    zero.

    Notes
    -----
    With x1 = w² and time stretched by w, equation (12) becomes linear between sign changes of x1: w' = (x2 − μ2·w)/2,
    x2' = −(μ1 + d)·w with |d| ≤ 1. In polar coordinates of (w, x2) the angle must fall from π/2 to −π/2; the growth of
    the radius per angle is a linear fraction of d, so that d = 1 or d = −1 is the worst in every direction, and the
    worst case is the integral of the pointwise maximum. If the angle stays constant, the radius only shrinks. The
    integral is computed numerically; it is not a proof.

    Source: derived for this project.
    """
    if mu1 <= 1.0:
        return math.inf  # the disturbance outweighs α: x2 is never turned back
    angle = np.linspace(-0.5 * math.pi, 0.5 * math.pi, _QUADRATURE)
    c, s = np.cos(angle), np.sin(angle)
    gain = mu1 + np.array([[-1.0], [1.0]])
    turning = -gain * c * c + 0.5 * s * (mu2 * c - s)  # dθ/dτ
    growing = 0.5 * c * (s - mu2 * c) - gain * s * c  # d ln r/dτ
    moves_on = turning < 0.0
    if not moves_on.any(axis=0).all():
        return 0.0
    per_angle = np.where(moves_on, growing / np.where(moves_on, -turning, 1.0), -np.inf).max(axis=0)
    steps = np.diff(angle)
    return float(math.exp(np.sum(0.5 * steps * (per_angle[1:] + per_angle[:-1]))))


def worst_case_mu2(mu1: float) -> float:
    """Return the least μ2 = λ/√C with which the error of Levant's differentiator contracts; infinite for μ1 ≤ 1."""
    if mu1 <= 1.0:
        return math.inf
    low, high = 0.0, LARGEST_MU2
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        if half_cycle_contraction(mu1, middle) < 1.0:
            high = middle
        else:
            low = middle
    return high
