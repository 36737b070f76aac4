"""The work that a wall gives back, exactly: for which K, B and damping b a rigid rig with its wall is passive.

Rig and wall are passive iff no motion, whatever its course within a tick, gets work out of them. Over a tick the effort
is u + (s − u)·e^{−t/τ}, with the command u and the lag's state s, so a motion counts only by two numbers in each tick:
its parts along 1 and along what e^{−t/τ} has beside it. Motions that repeat in each velocity period but for a phase θ
are N waves, w_m = e^{j(θ + 2πm)/N} per tick. In these, with d ticks of delay and ρ = e^{−T1/τ},

    spring, K     each wave by itself, effort a(w) on the increment p:  a = w^−d/(w − 1)·(p + (1 − w)/(w − ρ)·q)
    damper, B     all waves read through c = p/(w − 1) at the period's start, H once, then g_i in each tick: rank one

with p and q the parts of 1 and of e^{−t/τ}. The spring leaves C = b + K·Herm(a·pᵀ), 2 × 2 for each wave; the damper
adds B·Herm(h·a·cᵀ), h = H·ĝ·(w − 1)/N, of rank two. Passive is: at no θ has the sum a negative eigenvalue. By
Haynsworth's inertia formula, with U = [c̄, ha] and G = U*C⁻¹U, their number is that of C, plus the positive ones of
G + (2/B)·[[0, 1], [1, 0]], less one: 2 × 2 again, however many waves there are. Of slow motion (θ → 0) it is
b + B ≥ K·(T1/2 + lag + delay). The passive K and B form a convex set, for the matrix is linear in them.

Own derivation. For one rate it is |2b + H·S| ≥ |H|·√(Σ|L/ω|²·Σ|1/ω|²)·|1 − e^{−jωT}|/T, sums over aliases, L the lag
and S the sum of hold·L/(jω)²; without lag that is Colgate and Schenkel's theorem. Passive means: stable with any
passive hand, one that changes in time included. Of hands that are linear and do not change, Σ|S_k| in place of the
product of roots is exact; that asks for less damping, by 0 to 1.3 % where it was tried (lags of 0.2 to 20 ticks).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.analysis.theory.loop import LinearLoop

Vector = NDArray[np.float64]
Flags = NDArray[np.bool_]
Complex = NDArray[np.complex128]

SLOWEST = 1e-3  # θ/π of a scan; slower motions have a formula
LOW, EVEN = 200, 500  # phases of a scan: in equal ratios from the slowest up, and in equal steps
NEARER, REFINEMENTS = 60, 3  # phases around the worst one, and how often it is looked for anew
BISECTIONS = 40
SINGULAR = 1e-12  # a determinant this small is that of rounding


@dataclass(frozen=True, slots=True, eq=False)
class Waves:
    """Spring and damper as the waves of some phases θ meet them: arrays over phase and wave.

    Attributes
    ----------
    theta
        Phase over a velocity period (rad).
    along, beside
        Parts of a(w), times √T1: what a spring of 1 answers to an increment, and what the lag adds within a tick.
    read
        c(w), over √T1: position at the period's start.
    heard
        h: effort of a damper of 1 over that of a spring of 1.
    """

    theta: Vector
    along: Complex
    beside: Complex
    read: Complex
    heard: Complex

    @classmethod
    def of(cls, loop: LinearLoop, theta: Vector, *, late: bool = True) -> Waves:
        """Waves of these phases; not `late`: as if the effort acted at once."""
        n, tick_s = loop.divider, loop.tick_s
        lag_s, delay = (loop.subject.model.amplifier.lag_s, loop.delay_ticks) if late else (0.0, 0)
        w = np.exp(1j * (theta[:, None] + 2.0 * np.pi * np.arange(n)) / n)
        rho, mean, rest = _of_lag(lag_s / tick_s)
        answer = w ** -float(delay) / (w - 1.0)
        lagging = (1.0 - w) / (w - rho)
        i = np.arange(n)
        shape = np.ones((len(theta), n), complex)
        if loop.extrapolate:
            shape += i * (1.0 - np.exp(-1j * theta))[:, None] / n
        held = np.fft.fft(shape * np.exp(-1j * theta[:, None] * i / n), axis=1) / n
        estimate = loop.estimator.response(theta / (2.0 * np.pi * loop.period_s))
        return cls(
            theta,
            np.asarray(tick_s * answer * (1.0 + lagging * mean), complex),
            np.asarray(tick_s * answer * lagging * rest, complex),
            np.asarray(1.0 / (w - 1.0), complex),
            np.asarray(estimate[:, None] * held * (w - 1.0), complex),
        )

    def needed(self, sign: float) -> Vector:
        """Damping that a damper of ±1 asks for, without a spring, at each phase."""
        reading = (np.abs(self.read) ** 2).sum(axis=1)
        heard = (np.abs(self.heard) ** 2 * (np.abs(self.along) ** 2 + np.abs(self.beside) ** 2)).sum(axis=1)
        both = sign * (self.read * self.heard * self.along).sum(axis=1)
        return np.asarray(0.5 * (np.sqrt(np.maximum(reading * heard - both.imag**2, 0.0)) - both.real))

    def passive(self, stiffness: float, damping: float, rig: float) -> Flags:
        """Whether a rig of this damping and the wall are passive, at each phase."""
        k = 0.5 * stiffness
        aside = np.abs(self.beside) ** 2
        det = rig * (rig + 2.0 * k * self.along.real) - k**2 * aside
        failing = (det < 0.0).sum(axis=1)
        if damping == 0.0:
            return np.asarray(failing == 0)
        det = np.copysign(np.maximum(np.abs(det), SINGULAR * rig**2), det)
        reading = (rig * np.abs(self.read) ** 2 / det).sum(axis=1)
        heard = (rig * np.abs(self.heard) ** 2 * (np.abs(self.along) ** 2 + aside) / det).sum(axis=1)
        both = (self.read * self.heard * (rig * self.along - k * aside) / det).sum(axis=1)
        saddle = reading * heard <= np.abs(2.0 / damping + both) ** 2  # one positive eigenvalue, one negative
        return np.asarray(np.where(saddle, failing == 0, (failing == 1) & (reading < 0.0)))


def needed_per_damping(loop: LinearLoop, *, late: bool = True, negative: bool = False) -> float:
    """Damping of the rig that each unit of B asks for at K = 0; not `late`: as if the effort acted at once.

    `negative` asks for a wall of negative damping.
    """
    sign = -1.0 if negative else 1.0
    theta, best = _phases(), -sign  # of slow motion, whose velocity every estimator knows
    for _ in range(REFINEMENTS):
        values = Waves.of(loop, theta, late=late).needed(sign)
        worst = int(np.argmax(values))
        best = max(best, float(values[worst]))
        theta = _nearer(theta, worst)
    return best


def passive_stiffness(loop: LinearLoop, dampings: Sequence[float], rig: float) -> list[float]:
    """Largest K with which a wall of each B is passive on a rigid rig of damping `rig`; 0 where B alone is not."""
    waves = Waves.of(loop, _phases())
    return [_largest(loop, waves, damping, rig) for damping in dampings]


def _largest(loop: LinearLoop, waves: Waves, damping: float, rig: float) -> float:
    highest = (rig + damping) / (0.5 * loop.tick_s + loop.late_s)  # of slow motion
    if rig <= 0.0 or highest <= 0.0 or not waves.passive(0.0, damping, rig).all():
        return 0.0
    stiffness = highest
    for _ in range(REFINEMENTS):
        failing = ~waves.passive(stiffness, damping, rig)
        if not failing.any():
            break
        low, high = 0.0, stiffness
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            now = ~waves.passive(middle, damping, rig)
            low, high, failing = (low, middle, now) if now.any() else (middle, high, failing)
        stiffness = low
        waves = Waves.of(loop, _nearer(waves.theta, int(np.flatnonzero(failing)[0])))
    return stiffness


def _phases() -> Vector:
    low = np.geomspace(SLOWEST * math.pi, 0.1 * math.pi, LOW, endpoint=False)
    return np.concatenate([low, np.linspace(0.1 * math.pi, math.pi, EVEN)])


def _nearer(theta: Vector, worst: int) -> Vector:
    return np.linspace(theta[max(worst - 1, 0)], theta[min(worst + 1, len(theta) - 1)], NEARER)


def _of_lag(lag: float) -> tuple[float, float, float]:
    """For a lag in ticks: e^{−T1/τ}, the mean of e^{−t/τ} over a tick and the rms of what is left of it."""
    if lag == 0.0:
        return 0.0, 0.0, 0.0
    rho = math.exp(-1.0 / lag)
    mean = -lag * math.expm1(-1.0 / lag)
    return rho, mean, math.sqrt(max(-0.5 * lag * math.expm1(-2.0 / lag) - mean**2, 0.0))
