"""Compute exactly for which K, B and damping of the rig a rigid rig with its sampled wall is passive.

Rig and wall are passive iff no motion, whatever its course within a tick, extracts work from them. A motion that
repeats in each velocity period with a phase shift θ consists of N waves, w_m = e^{j(θ + 2πm)/N} per tick, each with
all its aliases ω_k = (arg w + 2πk)/T1. For a wave with velocities V_k, d ticks of delay and an electrical lag τ,

    the rig dissipates           Σ D(ω_k)·|V_k|²,  D = b + b_e/(1 + ω²τ²): viscous, and back-EMF behind the lag
    the wall reads               x = Σ V_k/(jω_k) at the tick
    an effort u does work u·y    y = Σ V̄_k·w^−d·(1 − 1/w)/(jω_k·T1)/(1 + jω_k·τ): delay, hold and lag

so only the numbers x and y of each wave matter. The least dissipation for given x and y follows from their Gram matrix
under 1/D = (1 + ω²τ²)/((b + b_e)·(1 + ω²σ²)), σ² = τ²·b/(b + b_e). Its sums over aliases are elementary. Scaled so that
the rig dissipates 1, with an orthonormal basis in each wave (x along its first vector, y = a in both):

    spring, K     each wave separately: C = 1 + K·Herm(a·xᵀ), 2 × 2
    damper, B     all waves, read at the period's start, H once, then g_i in each tick: B·Herm(h·a·cᵀ), h = H·ĝ/N

Rig and wall are passive if the sum has no negative eigenvalue at any θ. By Haynsworth's inertia formula, with
U = [c̄, ha] and G = U*C⁻¹U, the number of negative eigenvalues is that of C, plus the positive ones of the 2 × 2 matrix
G + (2/B)·[[0, 1], [1, 0]], minus one, for any number of waves. For slow motion (θ → 0) the condition is
b + b_e + B ≥ K·(T1/2 + lag + delay). The passive K and B form a convex set, because the matrix is linear in them.

Own derivation. For one rate the condition is |2b + H·S| ≥ |H|·√(Σ|L/ω|²·Σ|1/ω|²)·|1 − e^{−jωT}|/T, sums over aliases,
L the lag and S the sum of hold·L/(jω)²; without lag that is Colgate and Schenkel's theorem. Passive means stable with
any passive hand, also one that changes in time. For linear hands that do not change, Σ|S_k| in place of the product of
roots is exact; it needs less damping, by 0 to 1.3 % in the tested cases (lags of 0.2 to 20 ticks).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from rig.analysis.theory._loop import LinearLoop

Vector = NDArray[np.float64]
Flags = NDArray[np.bool_]
Complex = NDArray[np.complex128]

# Lowest phase of a scan, θ/π; for slower motions there is a formula.
SLOWEST = 1e-3
# Numbers of phases of a scan: first in equal ratios from the slowest one, then in equal steps.
LOW, EVEN = 200, 500
# Phases around the worst one, and number of times that the search is repeated with these.
NEARER, REFINEMENTS = 60, 3
BISECTIONS = 40
NO_SPRING = np.zeros(1)
# A smaller determinant is a rounding error.
SINGULAR = 1e-12


@dataclass(frozen=True, slots=True)
class Damping:
    """Damping of a rig (N·m·s/rad or N·s/m): viscous damping, and damping by back-EMF behind the electrical lag."""

    viscous: float
    back_emf: float = 0.0

    @property
    def slow(self) -> float:
        """Return the damping of a slow motion: the sum of viscous damping and back-EMF (N·m·s/rad or N·s/m)."""
        return self.viscous + self.back_emf

    def passive(self, loop: LinearLoop) -> bool:
        """Return True if this damping lets the rig render passive walls: it does not only act behind a lag."""
        return self.viscous > 0.0 or (self.slow > 0.0 and loop.subject.model.amplifier.lag_s == 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Waves:
    """Effect of the wall's spring and damper on sinusoidal motions (waves) of a rig, per phase θ and wave w_m.

    The symbols are those of the module's docstring. Shape (phases, N), except `theta`.

    Attributes
    ----------
    theta
        Phase θ over a velocity period (rad), shape (phases,).
    read, given
        Diagonal of the Gram matrix: largest |x|² and |y|² of a motion in which the rig dissipates 1.
    along
        Off-diagonal element of the Gram matrix, x·y.
    aside
        Part of y that is orthogonal to x: read·given − |along|².
    heard
        Effort of a damper of 1 over a position of 1, H·ĝ/N.
    """

    theta: Vector
    read: Vector
    given: Vector
    along: Complex
    aside: Vector
    heard: Complex

    @classmethod
    def of(cls, loop: LinearLoop, theta: Vector, rig: Damping, *, late: bool = True) -> Waves:
        """Return the effect of a wall's spring and damper on sinusoidal motions with phases `theta` (rad) per period.

        With `late` False, lag and delay of the effort are ignored.
        """
        n = loop.divider
        lag_s, delay = (loop.subject.model.amplifier.lag_s, loop.delay_ticks) if late else (0.0, 0)
        lag = lag_s / loop.tick_s
        turn = (theta[:, None] + 2.0 * np.pi * np.arange(n)) / n
        w = np.exp(1j * turn)
        squares, even, odd = _sums(turn, lag * math.sqrt(rig.viscous / rig.slow))
        late_even = squares - (lag**2 * rig.viscous / rig.slow) * even
        unit = loop.tick_s / rig.slow
        i = np.arange(n)
        shape = np.ones((len(theta), n), complex)
        if loop.extrapolate:
            shape += i * (1.0 - np.exp(-1j * theta))[:, None] / n
        held = np.fft.fft(shape * np.exp(-1j * theta[:, None] * i / n), axis=1) / n
        estimate = loop.estimator.response(theta / (2.0 * np.pi * loop.period_s))
        return cls(
            theta,
            unit * (late_even + lag**2 * even),
            unit * late_even / squares,
            np.asarray(unit * w ** -float(delay) * (1.0 / w - 1.0) * (late_even - 1j * lag * odd), complex),
            (unit * lag) ** 2 * np.maximum(even * late_even - odd**2, 0.0) / squares,
            np.asarray(estimate[:, None] * held, complex),
        )

    def at(self, which: NDArray[np.intp]) -> Waves:
        """Return the sinusoidal motions (waves) at the phases with the indices `which`."""
        return Waves(*(getattr(self, each.name)[which] for each in fields(self)))

    def needed(self, sign: float) -> Vector:
        """Return for each phase the share of the rig's damping that makes a wall damper of ±1 (`sign`) passive."""
        reading = self.read.sum(axis=1)
        heard = (np.abs(self.heard) ** 2 * self.given).sum(axis=1)
        both = sign * (self.heard * self.along).sum(axis=1)
        return np.asarray(0.5 * (np.sqrt(np.maximum(reading * heard - both.imag**2, 0.0)) - both.real))

    def passive(self, stiffness: Vector, damping: Vector) -> Flags:
        """Return True at each phase at which rig and wall are passive, as a boolean array of shape (phases,).

        `stiffness` and `damping` of the wall (SI) have one value for each phase, or one for all phases.
        """
        k = 0.5 * stiffness[:, None]
        det = 1.0 + 2.0 * k * self.along.real - k**2 * self.aside
        failing = (det < 0.0).sum(axis=1)
        # Haynsworth's formula divides by it; its sign is already counted.
        det = np.copysign(np.maximum(np.abs(det), SINGULAR), det)
        reading = (self.read / det).sum(axis=1)
        heard = (np.abs(self.heard) ** 2 * self.given / det).sum(axis=1)
        both = (self.heard * (self.along - k * self.aside) / det).sum(axis=1)
        with np.errstate(divide="ignore"):  # without a damper C alone counts
            lift = 2.0 / damping + both
        saddle = reading * heard <= np.abs(lift) ** 2  # one positive eigenvalue, one negative
        return np.asarray(np.where(saddle, failing == 0, (failing == 1) & (reading < 0.0)))


def needed_per_damping(loop: LinearLoop, rig: Damping, *, late: bool = True, negative: bool = False) -> float:
    """Return the share of the rig's damping that makes a wall of damping B = 1 (SI) passive, without a spring.

    The share is that of the worst phase. `late` includes lag and delay of the effort; with `negative`, B is negative.
    """
    sign = -1.0 if negative else 1.0
    # Slow motion needs this much of any estimator: it reads the velocity exactly.
    theta, best = _phases(), -sign / rig.slow
    for _ in range(REFINEMENTS):
        values = Waves.of(loop, theta, rig, late=late).needed(sign)
        worst = int(np.argmax(values))
        best = max(best, float(values[worst]))
        theta = _nearer(theta, worst)
    return best


def passive_stiffness(loop: LinearLoop, dampings: Sequence[float], rig: Damping) -> list[float]:
    """Return for each damping B of a virtual wall the largest stiffness K with which a rigid rig renders it passively.

    The units are SI. The result is 0 if the wall is not passive even without stiffness.
    """
    if not rig.passive(loop):
        return [0.0] * len(dampings)
    b, phases = np.asarray(dampings, float), _phases()
    waves = Waves.of(loop, phases, rig)
    highest = np.maximum((rig.slow + b) / (0.5 * loop.tick_s + loop.late_s), 0.0)  # of slow motion
    stiffness = np.where([waves.passive(NO_SPRING, one).all() for one in b[:, None]], highest, 0.0)

    # All dampings at once: of each that is left phases of its own, one after the other.
    left = np.flatnonzero(stiffness > 0.0)
    theta = np.tile(phases, (len(left), 1))
    waves = waves.at(np.tile(np.arange(len(phases)), len(left)))
    for _ in range(REFINEMENTS):
        of = np.repeat(left, theta.shape[1])
        failing = np.flatnonzero(~waves.passive(stiffness[of], b[of]))
        if not len(failing):
            break
        low, high = np.zeros(len(b)), stiffness
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            now = ~waves.at(failing).passive(middle[of[failing]], b[of[failing]])
            worse = np.isin(np.arange(len(b)), of[failing[now]])
            low, high = np.where(worse, low, middle), np.where(worse, middle, high)
            # Passive K form a convex set: a phase that is passive at one K is so below it and needs no further test.
            failing = failing[now | ~worse[of[failing]]]
        left, first = np.unique(of[failing], return_index=True)
        stiffness[left] = low[left]
        rows, worst = np.divmod(failing[first], theta.shape[1])
        theta = np.array([_nearer(theta[row], one) for row, one in zip(rows, worst, strict=True)])
        waves = Waves.of(loop, theta.ravel(), rig)
    return [float(k) for k in stiffness]


def _phases() -> Vector:
    low = np.geomspace(SLOWEST * math.pi, 0.1 * math.pi, LOW, endpoint=False)
    return np.concatenate([low, np.linspace(0.1 * math.pi, math.pi, EVEN)])


def _nearer(theta: Vector, worst: int) -> Vector:
    return np.linspace(theta[max(worst - 1, 0)], theta[min(worst + 1, len(theta) - 1)], NEARER)


def _sums(turn: Vector, sigma: float) -> tuple[Vector, Vector, Vector]:
    """Return Σ 1/z², Σ 1/(1 + σ²z²) and Σ 1/(z·(1 + σ²z²)) over the aliases z = turn + 2πk, z and σ in ticks."""
    half = 0.5 * turn
    squares, odd = 0.25 / np.sin(half) ** 2, 0.5 / np.tan(half)
    # The second sum is infinite without a lag, and is used only times a lag of 0.
    if sigma == 0.0:
        return squares, np.zeros_like(turn), odd
    # With q = e^(−1/σ), not cosh and sinh of 1/σ, which overflow for a short lag.
    q = math.exp(-1.0 / sigma)
    below = 1.0 + q * q - 2.0 * q * np.cos(turn)
    return squares, 0.5 * (1.0 - q * q) / sigma / below, odd - q * np.sin(turn) / below
