"""Compute the stability of a dual-rate wall from the loop's eigenvalues from one velocity sample to the next.

The law samples position at T1 and velocity at T2 = N·T1, so the loop is periodic and not time-invariant; lifted to T2
it is time-invariant. With the state z = [plant; estimator; velocity in use; its slope; commands in the delay] one tick
in the order of `rig.control.step` consists of the following; an estimator that uses the motor's effort has its states
of the effort and the mean of the commands since its last sample, too.

    V   in the first tick of a period: the estimator reads this position and outputs a new velocity
    E   in the other ticks: the velocity is held, or extrapolated by its slope
    P(K, B)   the law's effort −(K·θ + B·v) is commanded; the command whose delay has passed acts over T1

and the period is Φ = (P·E)^(N−1)·P·V. By linear theory the wall is stable iff all eigenvalues of Φ lie inside the unit
circle: `rig.analysis.theory._loop` lists what this leaves out.

Source: own derivation; the lifting is the standard one for periodic systems (Kranc 1957; Bittanti and Colaneri 2009).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.analysis.theory._linear import Realisation
from rig.analysis.theory._loop import LinearLoop, RigLike, SchemeLike, linear_loop
from rig.core.model import Matrix, Operator

Vector = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Numbers in a stack of matrices: half a megabyte, which a processor's cache holds, however many walls there are.
BLOCK = 1 << 16
# Powers of Φ that are tried before its eigenvalues; each is the 16th power of the previous one.
POWERS = 4
# A power decides about stability only if its bound differs from 1 by this factor.
CLEAR = 2.0
# Replaces matrix elements that overflowed within a period: such a wall is unstable.
HOPELESS = np.finfo(np.float64).max ** 0.25


@dataclass(frozen=True)
class Lifted:
    """The loop of a rig under a sampling scheme, as transition from one velocity sample to the next, for any wall.

    Attributes
    ----------
    tick
        Transition of the state over one tick without a wall, n × n.
    into
        Change of the state over one tick by a command of 1, length n.
    first, other
        V and E: update of the velocity before the law, in the first and in the other ticks of a period, n × n.
    position, velocity
        Rows that select the position and the velocity that the law uses, length n.
    softest
        The lifted loop at the position with the softest cogging, if the motor has cogging; a wall is stable only if it
        is stable at both positions. A wall that is softer than that cogging lets the handle slide to the next detent,
        which is not an oscillation: such a wall is not tested at that position.
    """

    loop: LinearLoop
    tick: Matrix
    into: Vector
    first: Matrix
    other: Matrix
    position: Vector
    velocity: Vector
    softest: Lifted | None = None

    @classmethod
    def of(cls, loop: LinearLoop) -> Lifted:
        """Return the transition matrices of a dual-rate loop, from one velocity sample to the next ("lifted")."""
        plant = len(loop.gamma)
        held = plant + _states(loop.estimator)
        queue = held + 2
        size = queue + loop.delay_ticks
        tick, into = np.eye(size), np.zeros(size)
        tick[:plant, :plant] = loop.phi
        if loop.delay_ticks == 0:
            into[:plant] = loop.gamma
        else:
            tick[:plant, queue] = loop.gamma
            tick[queue:, queue:] = np.eye(loop.delay_ticks, k=1)
            into[-1] = 1.0
        if loop.estimator.of_effort is not None:
            # The command that acts in this tick adds to the mean, which is the last state of the estimator.
            tick[held - 1, queue:] = np.eye(1, loop.delay_ticks) / loop.divider
            into[held - 1] = 0.0 if loop.delay_ticks else 1.0 / loop.divider
        position, velocity = np.zeros(size), np.zeros(size)
        position[loop.sensed], velocity[held] = 1.0, 1.0
        return cls(
            loop,
            tick,
            into,
            _sampling(loop, position, plant),
            _between(loop, size, plant),
            position,
            velocity,
            None if loop.softest is None else cls.of(loop.softest),
        )

    @cached_property
    def size(self) -> int:
        return len(self.into)

    def ticks(self, stiffness: ArrayLike, damping: ArrayLike) -> tuple[Matrix, Matrix]:
        """Return the loop's transition matrices of a tick with a velocity sample (P·V) and of each other tick (P·E).

        Stiffness and damping (SI) may have any shapes that broadcast; the matrices have shape (…, n, n).
        """
        k, b = np.broadcast_arrays(np.asarray(stiffness, float), np.asarray(damping, float))
        law = (k[..., None] - self.loop.compensated) * self.position + b[..., None] * self.velocity
        closed = self.tick - self.into[:, None] * law[..., None, :]
        return closed @ self.first, closed @ self.other

    def period(self, stiffness: ArrayLike, damping: ArrayLike) -> Matrix:
        """Return the loop's transition matrix Φ from one velocity sample to the next for each wall, shape (…, n, n)."""
        first, other = self.ticks(stiffness, damping)
        return (
            first if self.loop.divider == 1 else np.linalg.matrix_power(other, self.loop.divider - 1) @ first
        )

    def radius(self, stiffness: ArrayLike, damping: ArrayLike) -> Vector:
        """Return each wall's spectral radius from one velocity sample to the next; below 1 the wall is stable.

        Stiffness is in N·m/rad or N/m, damping in N·m·s/rad or N·s/m, of any shapes that broadcast.
        """
        return _worse_measure(self, np.maximum, _radius, stiffness, damping)

    def stable(self, stiffness: ArrayLike, damping: ArrayLike) -> Flags:
        """Return True for each wall with a spectral radius below 1, usually five times faster than by eigenvalues."""
        return _worse_measure(self, np.logical_and, _decays, stiffness, damping)

    def frequency(self, stiffness: float, damping: float) -> float:
        """Return the frequency (Hz) of the loop's least damped mode, not aliased by the velocity sampling.

        Frequencies above half the position rate are still aliased.
        """
        if self.softest is not None and self.softest.radius(stiffness, damping) >= self.radius(
            stiffness, damping
        ):
            return self.softest.frequency(stiffness, damping)
        phi = self.period(stiffness, damping)
        values, vectors = np.linalg.eig(phi)
        i = int(np.argmax(np.abs(values)))
        value, z = complex(values[i]), vectors[:, i].astype(complex)
        n, period_s = self.loop.divider, self.loop.period_s
        first, other = self.ticks(stiffness, damping)
        # An eigenvalue of Φ gives a frequency up to multiples of 1/T2. Tick by tick the mode's position is a part of
        # the exponential times a function of period T2, whose strongest harmonic decides the multiple.
        factor = value ** (1.0 / n) if value != 0.0 else 1.0
        wave = np.empty(n, complex)
        for k in range(n):
            wave[k] = self.position @ z / factor**k
            z = (first if k == 0 else other) @ z
        harmonic = int(np.argmax(np.abs(np.fft.fft(wave))))
        turns = math.atan2(value.imag, value.real) / (2.0 * math.pi) + harmonic
        return abs(turns - n * round(turns / n)) / period_s


def _worse_measure(
    lifted: Lifted,
    worse: np.ufunc,
    measure: Callable[[Matrix], NDArray[Any]],
    stiffness: ArrayLike,
    damping: ArrayLike,
) -> NDArray[Any]:
    """Return `measure` of each wall's transition matrix Φ; with cogging, the `worse` of its two extreme positions."""
    k, b = np.broadcast_arrays(np.asarray(stiffness, float), np.asarray(damping, float))
    block = max(1, BLOCK // lifted.size**2)
    blocks = (slice(i, i + block) for i in range(0, max(k.size, 1), block))
    own = np.concatenate([measure(lifted.period(k.ravel()[i], b.ravel()[i])) for i in blocks]).reshape(
        k.shape
    )
    softest = lifted.softest
    if softest is None:
        return own
    # A wall softer than the cogging there lets the handle slide to the next detent, which is no oscillation.
    rests = k + softest.loop.cogging - softest.loop.compensated > 0.0
    return np.where(rests, worse(own, _worse_measure(softest, worse, measure, k, b)), own)


def _radius(phi: Matrix) -> Vector:
    phi = np.where(np.isfinite(phi), phi, HOPELESS)
    return np.asarray(np.abs(np.linalg.eigvals(phi)).max(axis=-1))


def _decays(phi: Matrix) -> Flags:
    """Return True for each Φ whose spectral radius ρ is below 1.

    Bounds by powers m of 16 decide first: ρ^m ≤ ‖Φ^m‖ and ρ^m ≥ |trace Φ^m|/n; eigenvalues decide the rest.
    """
    # Powers cost a fifth of eigenvalues and round alike: both are wrong by some 1e-16 times the eigenvalue's condition.
    # A power decides only where ρ is farther from 1 than CLEAR^(1/m), which is 1e-5 at the last one.
    decays, undecided, power = np.zeros(len(phi), np.bool_), np.arange(len(phi)), phi
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is not clear
        for _ in range(POWERS):
            power = np.linalg.matrix_power(power, 16)
            small = np.einsum("ijk,ijk->i", power, power) < CLEAR**-2
            large = np.abs(np.einsum("ijj->i", power)) > CLEAR * phi.shape[-1]
            decays[undecided[small]] = True
            unclear = ~(small | large)
            undecided, power = undecided[unclear], power[unclear]
    decays[undecided] = _radius(phi[undecided]) < 1.0
    return decays


def spectral_radius(
    rig: RigLike,
    scheme: SchemeLike | None,
    stiffness: ArrayLike,
    damping: ArrayLike,
    *,
    operator: str | Operator | None = None,
) -> Vector:
    """Return a rig's spectral radius from one velocity sample to the next: below 1 the wall is stable.

    Parameters
    ----------
    rig, scheme, operator
        Rig; sampling scheme (rates and velocity estimator); model of the hand on the handle, or None for the rig's own.
    stiffness, damping
        K (N·m/rad or N/m) and B (N·m·s/rad or N·s/m), of any shapes that broadcast.

    Returns
    -------
    ndarray
        Spectral radius, in the broadcast shape. It is 1 for a stiffness of zero: a free handle stays where it is.
    """
    return Lifted.of(linear_loop(rig, scheme, operator=operator)).radius(stiffness, damping)


def _sampling(loop: LinearLoop, position: Vector, plant: int) -> Matrix:
    """Return the matrix V of a tick with a velocity sample: it updates the velocity, and its slope."""
    e = loop.estimator
    held = plant + _states(e)
    slope, mean = held + 1, np.zeros(len(position))
    mean[held - 1] = 1.0
    matrix, estimate = np.eye(len(position)), np.zeros(len(position))
    for part, read, first in ((e, position, plant), (e.of_effort, mean, plant + e.order)):
        if part is not None:
            rows = slice(first, first + part.order)
            matrix[rows] = part.b[:, None] * read
            matrix[rows, rows] = part.a
            estimate += part.d * read
            estimate[rows] = part.c
    if e.of_effort is not None:
        matrix[held - 1] = 0.0  # the mean begins anew
    matrix[held], matrix[slope] = estimate, 0.0
    if loop.extrapolate:
        matrix[slope] = estimate / loop.divider
        # The extrapolation starts from the velocity in use, without the part that was extrapolated before.
        matrix[slope, held] -= 1.0 / loop.divider
        matrix[slope, slope] += (loop.divider - 1) / loop.divider
    return matrix


def _between(loop: LinearLoop, size: int, plant: int) -> Matrix:
    """Return the matrix E of a tick without a velocity sample: the velocity changes by its slope (0 if held)."""
    matrix = np.eye(size)
    held = plant + _states(loop.estimator)
    matrix[held, held + 1] = 1.0
    return matrix


def _states(estimator: Realisation) -> int:
    """Return the number of states of an estimator in the loop, the mean effort included if it uses the effort."""
    return estimator.order + (0 if estimator.of_effort is None else estimator.of_effort.order + 1)
