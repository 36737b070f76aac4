"""Predict amplitude and frequency of the limit cycle that the encoder's quantum causes, with describing functions.

A constant push holds the handle at rest in the wall if the mean reading is push/K, which is usually not a whole number
of counts: the count toggles, and the effort toggles with it by K·Δ or more. Suppose that the encoder's side moves as x0
+ A·cos ωt. Then the first harmonic

    of the reading is  q = (2Δ/π)·Σ √(1 − ((e − x0)/A)²)   over the edges e that are crossed, in phase with x,
    of a friction is   4·f/π, against the velocity of its mass,

The rest of the loop is linear: the law C = K + B·H(e^{jωT2})·h, with h the mean over its period of a velocity that is
held (and extrapolated), the delay, and the plant G at its ticks, hold included. The loop balances if

    A = −G·C·q(A, x0) − friction,   with imaginary part 0,   and   mean reading = push/K,

three equations for A, ω and x0. Without friction, ω is the frequency at which the phase of G·C is −180°, for any A, and
A = |G·C|·q. While one edge is crossed, A is at most (2/π)·|G·C| counts, so a wall that is linearly stable (|G·C| < 1)
buzzes by less than 0.64 counts. `duty` is the fractional part of the mean reading in counts: the limit cycle is largest
at ½; at 0 it does not exist (until A is half a count).

The theory assumes a sinusoidal motion without rest. The loop is a low pass, so harmonics of the reading, its images by
the velocity's sampling and toggling between two ticks are left out.

Source: own derivation; describing functions are textbook (Gelb and Vander Velde 1968, not opened).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.analysis.theory._loop import LinearLoop, RigLike, SchemeLike, linear_loop
from rig.core.model import state_space

Vector = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Grid of frequencies, in equal ratios up to half the position rate.
LOWEST_HZ, POINTS = 1.0, 6000
# The amplitude has converged if its relative change is below `SETTLED`.
ITERATIONS, SETTLED = 300, 1e-6
# Iterations of the phase of the second mass's friction.
TURNS = 12
# In counts: a larger oscillation is not caused by the quantum.
LARGEST = 1e3
BISECTIONS = 60
# Largest number of edges that the motion crosses on each side.
EDGES = 2000
# Amplitude and frequency if the loop balances at no frequency.
NOTHING = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class LimitCycle:
    """A self-sustained oscillation of a handle in a virtual wall, as predicted by `limit_cycle`.

    Attributes
    ----------
    amplitude
        Amplitude at the encoder, half of the peak-to-peak motion (counts); 0 if there is no limit cycle, ∞ if it grows
        beyond `LARGEST` counts.
    frequency_hz
        Frequency of the limit cycle (Hz); NaN without a limit cycle.
    may_rest
        True if friction can hold the handle at rest instead.
    alone
        True if only one limit cycle is possible without friction; otherwise others than the predicted one may exist.
    """

    amplitude: float
    frequency_hz: float
    may_rest: bool
    alone: bool

    @property
    def found(self) -> bool:
        """Return True if a limit cycle of finite amplitude exists."""
        return 0.0 < self.amplitude < math.inf


def limit_cycle(
    rig: RigLike | LinearLoop,
    scheme: SchemeLike | None,
    stiffness: float,
    damping: float,
    *,
    duty: float = 0.5,
    friction: bool = True,
    operator: str | None = None,
) -> LimitCycle:
    """Predict the limit cycle of a handle that a constant external effort (push) holds in a virtual wall.

    Parameters
    ----------
    rig, scheme, operator
        Rig; sampling scheme (rates and velocity estimator); model of the hand on the handle, or None for the rig's own.
    stiffness, damping
        K (N·m/rad or N/m) and B (N·m·s/rad or N·s/m).
    duty
        Fractional part of the mean reading push/K in counts, 0 to 1.
    friction
        True to include Coulomb friction.

    Raises
    ------
    ConfigError
        The rig, the sampling scheme or the hand is not valid.
    NotLinearError
        Linear theory does not cover the estimator or the wall.
    """
    loop = rig if isinstance(rig, LinearLoop) else linear_loop(rig, scheme, operator=operator)
    model = loop.subject.model
    held = sum(state_space(model.mechanics, model.amplifier).friction) if friction else 0.0
    open_loop = _Open.of(loop, stiffness, damping, friction=friction)
    balances = [open_loop.balance(at, duty) for at in open_loop.crossings(duty)]
    # The largest of several balances: which one is seen depends on where the handle comes from. Only a single one
    # (`alone`) is a prediction, and friction does not decide: where a mass rests in part of its period, friction
    # dissipates less than this model assumes, and a cycle that the model rules out may persist.
    amplitude, frequency = max(balances, default=NOTHING)
    smooth = _Open.of(loop, stiffness, damping, friction=False) if friction else open_loop
    return LimitCycle(
        amplitude=amplitude,
        frequency_hz=frequency if amplitude > 0.0 else math.nan,
        may_rest=min(duty, 1.0 - duty) * stiffness * model.encoder.resolution <= held,
        alone=len(smooth.crossings(duty)) <= 1,
    )


def reading(amplitude: float, duty: float) -> float:
    """Return the first harmonic (counts) of the encoder's reading of a motion x0 + A·cos ωt.

    `amplitude` is A in counts; x0 is such that the mean reading is a whole number of counts plus `duty`. For an
    amplitude of 0 return the value of a single edge, (2/π)·sin(π·duty).
    """
    if amplitude <= 0.0:
        return 2.0 / math.pi * math.sin(math.pi * duty)
    reach = min(math.ceil(amplitude) + 1, EDGES)
    edges = np.arange(-reach, reach + 1) + 0.5

    def crossed(bias: float) -> Vector:
        return np.asarray(np.clip((edges - bias) / amplitude, -1.0, 1.0))

    # The mean reading rises with the bias, from 0 about cell 0 to 1 about cell 1.
    below = float(np.sum(edges < 0.0))
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        bias = 0.5 * (low + high)
        mean = float(np.sum(np.arccos(crossed(bias)) / math.pi)) - below
        low, high = (bias, high) if mean < duty else (low, bias)
    return float(2.0 / math.pi * np.sum(np.sqrt(1.0 - crossed(0.5 * (low + high)) ** 2)))


@dataclass(frozen=True, slots=True, eq=False)
class _Open:
    """Frequency responses of the open loop: motion of both masses (counts) per count of reading, and per friction."""

    hz: Vector
    loop: Complex  # encoder's side, from the reading
    other: Complex  # the other mass
    rubs: tuple[float, ...]  # 4·f/π of the encoder's mass, then of the other
    rubbed: tuple[Complex, ...]  # encoder's side, from an effort on each mass
    rubbed_other: tuple[Complex, ...]  # the other mass, likewise

    @classmethod
    def of(cls, loop: LinearLoop, stiffness: float, damping: float, *, friction: bool) -> _Open:
        model = loop.subject.model
        hz = np.geomspace(LOWEST_HZ, 0.5 / loop.tick_s, POINTS, endpoint=False)
        space = state_space(model.mechanics, model.amplifier, loop.subject.operator)
        z, s = np.exp(2j * np.pi * hz * loop.tick_s), np.asarray(2j * np.pi * hz, complex)
        late = z**-loop.delay_ticks * _law(loop, stiffness, damping, hz, z)
        driven = -_states(z, loop.phi, loop.gamma) * late[:, None]
        own, other = space.sensed_position, space.handle_position
        rubbed = [
            _states(s, space.a, column) / model.encoder.resolution
            for column in space.b[:, space.friction_inputs].T
        ]
        return cls(
            hz=hz,
            loop=driven[:, own],
            other=driven[:, other],
            rubs=tuple(4.0 / math.pi * level if friction else 0.0 for level in space.friction),
            rubbed=tuple(states[:, own] for states in rubbed),
            rubbed_other=tuple(states[:, other] for states in rubbed),
        )

    def motion(self, read: float) -> Complex:
        """Return the complex motion at the encoder (counts) per frequency, for a reading of `read` counts amplitude."""
        x = read * self.loop - 1j * self.rubs[0] * self.rubbed[0]
        if not any(self.rubs[1:]):
            return np.asarray(x)
        driven = read * self.other - 1j * self.rubs[0] * self.rubbed_other[0]
        y, rub = driven, np.zeros_like(driven)
        # The other mass's friction turns with its motion, which depends on that friction: a fixed-point iteration.
        for _ in range(TURNS):
            rub = -1j * self.rubs[1] * np.exp(1j * np.angle(y))
            y = driven + rub * self.rubbed_other[1]
        return np.asarray(x + rub * self.rubbed[1])

    def crossings(self, duty: float) -> list[float]:
        """Return the frequencies (Hz) at which a minute limit cycle, over one encoder edge, is possible."""
        return [frequency for frequency, _ in self._in_phase(reading(0.0, duty))]

    def _in_phase(self, read: float) -> list[tuple[float, float]]:
        """Return pairs of a frequency (Hz) at which motion and reading are in phase, and the amplitude (counts)."""
        x = self.motion(read)
        place = np.flatnonzero((x.imag[1:] > 0.0) != (x.imag[:-1] > 0.0))
        share = x.imag[place] / (x.imag[place] - x.imag[place + 1])
        amplitude = x.real[place] + share * (x.real[place + 1] - x.real[place])
        frequency = self.hz[place] * (self.hz[place + 1] / self.hz[place]) ** share
        return [(float(f), float(a)) for f, a in zip(frequency, amplitude, strict=True) if a > 0.0]

    def balance(self, frequency: float, duty: float) -> tuple[float, float]:
        """Return amplitude (counts) and frequency (Hz) of the limit cycle near `frequency` (Hz); (0, 0) without one.

        The amplitude is infinite beyond `LARGEST` counts; `duty` is the fractional part of the mean reading (counts).
        """
        read, amplitude = reading(0.0, duty), 0.0
        for _ in range(ITERATIONS):
            there = self._in_phase(read)
            if not there:
                return NOTHING
            frequency, found = min(there, key=lambda one: abs(math.log(one[0] / frequency)))
            if found > LARGEST:
                return math.inf, frequency
            if abs(found - amplitude) <= SETTLED * found:
                break
            amplitude, read = found, reading(found, duty)
        return amplitude, frequency


def _law(loop: LinearLoop, stiffness: float, damping: float, hz: Vector, z: Complex) -> Complex:
    """Return effort over position reading of the control law at each frequency: K + B·estimator·hold."""
    ticks = np.arange(loop.divider)
    used = np.ones((len(hz), loop.divider), complex)
    if loop.extrapolate:
        used += (1.0 - np.exp(-2j * np.pi * hz * loop.period_s))[:, None] * ticks / loop.divider
    held = np.mean(used * z[:, None] ** -ticks, axis=1)
    return np.asarray(stiffness + damping * loop.estimator.response(hz) * held)


def _states(at: Complex, a: Vector, b: Vector) -> Complex:
    resolvent = at[:, None, None] * np.eye(len(b)) - a
    return np.asarray(np.linalg.solve(resolvent, np.broadcast_to(b[:, None], (len(at), len(b), 1)))[..., 0])
