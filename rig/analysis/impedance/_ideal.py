"""Closed forms of the impedance of an ideal wall, of a rig without a wall, and of a rig with a sampled wall.

For a rigid rig without lag, a wall at one rate and an estimator H(z) (velocity over position), the impedance is

    Z = m·s + b + ZOH(s)·C/s / (1 + A·C),   C = K + B·H(e^{sT}),   ZOH = (1 − e^{−sT})/(s·T),   s = jω

The excitation is continuous, the wall is sampled: it reads the position at its ticks, where motions at all frequencies
ω + n·2π/T (images) look alike, and its held effort moves the rig at all these frequencies. A is the sum of the images:
with P from effort to position and G its discretisation (hold, plant, sampler), A = G(e^{sT}) − ZOH·P = Σ_{n≠0} P·ZOH at
ω + n·2π/T. Without images (``images=False``) the impedance is m·s + b + ZOH·(K/s + B·H/s).

For 0.52 kg at 1 kHz, fdm, fdm-butterworth and kalman, at every spectral line up to 400 Hz, images change Z by at most
0.16 % and 0.05° for stable walls up to 40 kN/m and 100 N·s/m, by 1.4 % up to 100 kN/m, and by 7 % for the stiffest
walls that are just stable. In a record of the loop's own ticks the images are 3 % at 250 Hz and 29 % at 400 Hz. At half
the rate a line and its image coincide, and no impedance is defined.

In general (two masses, lag, delay in ticks, position at T1 and velocity at T2 = N·T1, held or extrapolated) the sampled
loop has N frequencies ω + m·2π/T2 that the velocity path mixes. With x_m the sampled position at each frequency, G_m
the discretisation, D_m the delay, h_m the pattern in which a velocity is used over its N ticks, u_m the command:

    u_m = K·x_m + B·h_m·w,   w = H·mean(x_m),   x_m = [m = 0]·P_x·F − G_m·D_m·u_m

which is solved for w in one line; the position at ω between the samples is then P_y·F − Q_y·ZOH·D_0·u_0.

Coulomb friction, quantum and saturation are left out. The closed form also returns a value for an unstable wall, which
has no steady motion: check stability with `rig.analysis.theory`. Source: own derivation; sampled-data arithmetic is
textbook.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from rig.analysis.impedance._signals import Complexes, Floats, hold
from rig.analysis.theory._loop import LinearLoop, RigLike, SchemeLike, linear_loop
from rig.core.model import Matrix, StateSpace, state_space

Seen = Literal["handle", "sensed", "samples"]
Channel = Literal["external", "motor"]


def ideal_wall(stiffness: float, damping: float, lines_hz: ArrayLike) -> Complexes:
    """Return the impedance K/(jω) + B of the requested wall at the frequencies `lines_hz` (Hz)."""
    return np.asarray(stiffness / _s(lines_hz) + damping)


def bare(
    rig: RigLike | LinearLoop,
    lines_hz: ArrayLike,
    *,
    scheme: SchemeLike | None = None,
    seen: Literal["handle", "sensed"] = "handle",
) -> Complexes:
    """Return the impedance of a rig without a wall and without friction: m·s + b if the rig is rigid.

    The result (N·m·s/rad or N·s/m) has the shape of `lines_hz` (Hz). `seen` is where the position is measured:
    ``"handle"`` or ``"sensed"`` (encoder); `scheme` has no effect here.
    """
    plant = _Plant.of(_loop(rig, scheme))
    return np.asarray(1.0 / (_s(lines_hz) * plant.response(lines_hz, plant.row(seen), EXTERNAL)))


def rendered_impedance(
    rig: RigLike | LinearLoop,
    stiffness: float,
    damping: float,
    lines_hz: ArrayLike,
    *,
    scheme: SchemeLike | None = None,
    seen: Seen = "handle",
    channel: Channel = "external",
    images: bool = True,
) -> Complexes:
    """Return the impedance of a rig whose motor renders a virtual wall in a sampled loop, exact for a linear estimator.

    Parameters
    ----------
    rig, scheme
        Rig and sampling scheme (rates and velocity estimator); `NotLinearError` is raised for an estimator that is not
        linear.
    stiffness, damping
        K (N·m/rad or N/m) and B (N·m·s/rad or N·s/m) of a bilateral wall.
    lines_hz
        Frequencies (Hz), shape (n,), without half of the velocity rate and its multiples.
    seen
        Where the position is measured. ``"handle"``: at the handle. ``"sensed"``: on the encoder's side (on two masses
        this is not a driving-point impedance, so its phase does not show passivity). ``"samples"``: on the encoder's
        side at the loop's ticks only, as a rig records it; this adds the images.
    channel
        ``"external"``: a continuous effort F on the handle excites. ``"motor"``: the motor excites, and F is the
        commanded excitation, held over a tick, before delay and lag.
    images
        False leaves the images out (A in the formula of `rig.analysis.impedance._ideal`).

    Returns
    -------
    ndarray of complex
        F/(jω·X) (N·m·s/rad or N·s/m), shape (n,).
    """
    return walls(rig, lines_hz, scheme=scheme, seen=seen, channel=channel, images=images)(stiffness, damping)


def walls(
    rig: RigLike | LinearLoop,
    lines_hz: ArrayLike,
    *,
    scheme: SchemeLike | None = None,
    seen: Seen = "handle",
    channel: Channel = "external",
    images: bool = True,
) -> Callable[[float, float], Complexes]:
    """Return a function of stiffness and damping (SI) that returns the impedance of the rig with this virtual wall.

    Use it for many walls: what does not depend on the wall is computed once. Arguments as for `rendered_impedance`.
    """
    loop = _loop(rig, scheme)
    plant = _Plant.of(loop)
    lines = np.atleast_1d(np.asarray(lines_hz, dtype=np.float64))
    held = hold(lines, loop.tick_s)
    loops = _sample_loop(loop, plant, lines, images)
    own, row = channel == "motor", plant.row(seen)
    # Position at the samples that each unit of excitation makes, the wall aside.
    made = loops.forward[:, 0] if own else plant.response(lines, plant.sensed, EXTERNAL)
    by_motor = plant.response(lines, row, COMMAND) * held * loops.late
    free = by_motor if own else plant.response(lines, row, EXTERNAL)
    scale = (held if own else 1.0) / _s(lines)

    def wall(stiffness: float, damping: float) -> Complexes:
        share = 1.0 / (1.0 + loops.forward * stiffness)
        velocity = (loops.mean * made * share[:, 0]) / (
            1.0 + damping * np.sum(loops.mean[:, None] * loops.pattern * loops.forward * share, axis=1)
        )
        sampled = share[:, 0] * (made - loops.forward[:, 0] * damping * loops.pattern[:, 0] * velocity)
        if seen == "samples":
            return np.asarray(scale / sampled)
        command = stiffness * sampled + damping * loops.pattern[:, 0] * velocity
        return np.asarray(scale / (free - by_motor * command))

    return wall


COMMAND, EXTERNAL = 0, 1  # inputs of `rig.core.model.StateSpace`


@dataclass(frozen=True, eq=False)
class _Plant:
    """State-space matrices of the continuous rig, and the indices of encoder and handle position in the state."""

    a: Matrix
    b: Matrix
    sensed: int
    handle: int

    @classmethod
    def of(cls, loop: LinearLoop) -> _Plant:
        subject = loop.subject
        model: StateSpace = state_space(subject.model.mechanics, subject.model.amplifier, subject.operator)
        return cls(model.a, model.b, model.sensed_position, model.handle_position)

    def row(self, seen: Seen) -> int:
        return self.handle if seen == "handle" else self.sensed

    def response(self, lines_hz: ArrayLike, row: int, column: int) -> Complexes:
        return _transfer(_s(np.atleast_1d(lines_hz)), self.a, self.b[:, column], row)


@dataclass(frozen=True, eq=False)
class _Sampled:
    """Factors G·D, h, H/N and D_0 of the formula above at the frequencies ω + m·2π/T2, shape (n, N) or (n,)."""

    forward: Complexes  # G_m·D_m, from command to sampled position
    pattern: Complexes  # h_m, from a velocity to how it is used in the N ticks of its period
    mean: Complexes  # H/N
    late: Complexes  # D_0


def _sample_loop(loop: LinearLoop, plant: _Plant, lines: Floats, images: bool) -> _Sampled:
    n = loop.divider
    frequency = lines[:, None] + np.arange(n) / loop.period_s
    z = np.exp(2j * np.pi * frequency * loop.tick_s)
    late = z**-loop.delay_ticks
    if images:
        forward = _transfer(z.ravel(), loop.phi, loop.gamma, loop.sensed).reshape(z.shape)
    else:
        forward = np.zeros_like(z)
        forward[:, 0] = plant.response(lines, plant.sensed, COMMAND) * hold(lines, loop.tick_s)
    ticks = np.arange(n)
    turns = z[:, :, None] ** -ticks
    use = np.ones((len(lines), 1, n), np.complex128)
    if loop.extrapolate:
        since = 1.0 - np.exp(-2j * np.pi * lines * loop.period_s)
        use = use + since[:, None, None] * ticks / n
    return _Sampled(
        forward * late, np.sum(turns * use, axis=2), loop.estimator.response(lines) / n, late[:, 0]
    )


def _transfer(s: Complexes, a: Matrix, b: Floats, row: int) -> Complexes:
    resolvent = s[:, None, None] * np.eye(len(b)) - a
    states = np.linalg.solve(resolvent, np.broadcast_to(b[:, None], (len(s), len(b), 1)))
    return np.asarray(states[:, row, 0])


def _loop(rig: RigLike | LinearLoop, scheme: SchemeLike | None) -> LinearLoop:
    return rig if isinstance(rig, LinearLoop) else linear_loop(rig, scheme)


def _s(lines_hz: ArrayLike) -> Complexes:
    return np.asarray(2j * np.pi * np.asarray(lines_hz, dtype=np.float64))
