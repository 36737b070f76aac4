"""Find the discrete state space of a linear estimator from its responses: probe it, check its linearity, realise it.

The probe calls the compiled update with counts, so that an estimator of a third party needs no formula. After a rest
comes an impulse of many counts; the response h gives the Markov parameters of a state space (A, B, C, D). The estimator
is linear if impulses of another size, position and time have the same response, and the response to a random walk with
jumps is its convolution with h. An estimator that adapts its window, has a noise band, rounds inside or reads edge
times is rejected.

The realisation is that of Ho and Kalman by a singular value decomposition (Juang and Pappa 1985, "ERA"). Rows and
columns of the Hankel matrix are thinned towards the far end of h: a low pass at a hundredth of the rate rings for a
thousand samples but has three states. The order is the smallest that reproduces h.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.control import estimators
from rig.control.estimators import Estimator, inputs, run
from rig.core.errors import ConfigError
from rig.core.model import Matrix

Vector = NDArray[np.float64]

IMPULSE = 1 << 20  # counts
# Samples by which an impulse is delayed, to test whether the response depends on time.
LATER = 137
# Counts by which a motion is shifted, to test whether the response depends on the position.
PLACE = 4321
FIRST_REST, LONGEST_REST = 256, 1 << 16  # samples at rest before an impulse
FIRST_LENGTH, LONGEST_LENGTH = 512, 1 << 16  # samples of h
WANDERING = 1024  # samples of the random walk
# Relative difference of two responses that rounding may cause.
SAME = 1e-9
# The response h has faded when it stays below this share of its peak.
FADED = 1e-13
# The order is the smallest one with this relative error of h …
REALISED = 1e-11
# … or if no order achieves it, the one with the smallest error, up to this limit.
ACCEPTED = 1e-8
LARGEST_ORDER = 40
HANKEL = 96  # rows and columns at most


class NotLinearError(ConfigError):
    """An estimator or a law is not linear, so linear theory does not apply; `reason` is the explanation."""

    def __init__(self, message: str, *, reason: str, remedy: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.reason = reason


@dataclass(frozen=True, slots=True, eq=False)
class Realisation:
    """State space of an estimator, x ← A x + B p, v = C x + D p, with position p, velocity v (SI) and state x.

    It is updated once in each velocity period (time between two velocity samples). ``a`` is order × order, ``b`` and
    ``c`` have length order. `error` is the largest difference between the impulse response of these matrices and that
    of the estimator, relative to its peak. `of_effort` is the same for the motor's mean effort since the sample before,
    whose velocity is added; None if the estimator does not use the effort.
    """

    a: Matrix
    b: Vector
    c: Vector
    d: float
    period_s: float
    error: float
    name: str
    of_effort: Realisation | None = None

    @property
    def order(self) -> int:
        return len(self.b)

    def response(self, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
        """Return the frequency response of an estimator, velocity over position (1/s), at each frequency (Hz)."""
        self.check_counts_alone()
        z = np.exp(2j * np.pi * self.period_s * np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64)))
        resolvent = z[:, None, None] * np.eye(self.order) - self.a
        states = np.linalg.solve(resolvent, np.broadcast_to(self.b[:, None], (len(z), self.order, 1)))
        return np.asarray(states[..., 0] @ self.c + self.d)

    def check_counts_alone(self) -> None:
        """Raise `NotLinearError` for an estimator that uses the effort: its frequency response needs the wall, too."""
        if self.of_effort is not None:
            raise NotLinearError(
                f"estimator {self.name}: passivity and limit cycles have no theory with the effort, which it uses",
                reason="its estimate depends on the motor's effort, which this theory does not contain",
                remedy="use a simulation, or an estimator of the counts alone, such as fdm-butterworth or tracking",
            )

    def impulse(self, samples: int) -> Vector:
        """Return `samples` velocities of an estimator, for a position of 1 at the first sample and 0 afterwards."""
        return _impulse(self.a, self.b, self.c, self.d, samples)


def realise(
    name: str, settings: Mapping[str, float | str], period_s: float, resolution: float
) -> Realisation:
    """Return an estimator's state space with these settings; `period_s` is the time between velocity samples (s).

    `resolution` is the travel for one count (rad or m); it matters only if a setting has a unit of position.

    Raises
    ------
    ConfigError
        Unknown estimator, or settings that cannot be realised.
    NotLinearError
        The estimator is not linear.
    """
    found = _find_realisation(estimators.get(name), tuple(settings.items()), period_s, resolution)
    if isinstance(found, str):
        settings_text = ", ".join(f"{key} = {value}" for key, value in settings.items())
        raise NotLinearError(
            f"estimator {name}{f' ({settings_text})' if settings_text else ''} is not linear: {found}",
            reason=found,
            remedy="use a linear estimator, such as fdm, fdm-butterworth or kalman without fading; "
            "simulate the others",
        )
    return found


# Cached: a session's conditions, hands and delays request the same few estimators repeatedly.
@lru_cache(maxsize=256)
def _find_realisation(
    estimator: Estimator, settings: tuple[tuple[str, float | str], ...], period_s: float, resolution: float
) -> Realisation | str:
    """Return the state space of an estimator, or the reason why the estimator is not linear."""
    found: list[Realisation] = []
    for of_effort in (False, True)[: 1 + estimator.uses_effort]:
        probe = _Probe(estimator, dict(settings), period_s, resolution, of_effort)
        rest, h = _settled_response(probe)
        if of_effort and not h.any():
            continue  # a user's function may have the argument without using it; the sum below shows whether it does
        reason = _nonlinearity(probe, rest, h)
        if reason:
            return reason
        found.append(_realise(estimator.name, h, period_s))
    if not estimator.uses_effort:
        return found[0]
    still, walk = np.zeros(rest, np.int64), _random_walk(WANDERING)
    counts, efforts = np.concatenate([still, walk]), np.concatenate([still, walk[::-1]])
    alone = replace(probe, of_effort=False).motion(counts)
    if found[1:]:
        alone = alone + probe.motion(efforts) / resolution
    if not _are_close(alone, probe.velocities(counts, efforts) / resolution, SAME):
        return "the response to counts and efforts together is not the sum of both"
    return replace(found[0], of_effort=found[1] if found[1:] else None)


@dataclass(frozen=True, slots=True)
class _Probe:
    """A velocity estimator with its settings, prepared again for each sequence of encoder counts."""

    estimator: Estimator
    settings: Mapping[str, float | str]
    period_s: float
    resolution: float
    of_effort: bool  # probe by an effort while the handle rests, instead of by counts without effort

    def motion(self, values: NDArray[np.int64]) -> Vector:
        """Return an estimator's velocities in response to counts (counts/s), or to efforts (rad/s or m/s)."""
        none = np.zeros_like(values)
        if self.of_effort:
            return self.velocities(none, values)
        return self.velocities(values, none) / self.resolution

    def velocities(self, counts: NDArray[np.int64], efforts: NDArray[np.int64]) -> Vector:
        """Return the velocities of an estimator (rad/s or m/s) in response to encoder counts and efforts."""
        prepared = self.estimator.prepare(self.settings, self.resolution, self.period_s)
        effort = (efforts.astype(np.float64),) if self.estimator.uses_effort else ()
        return run(prepared, *inputs(counts, self.period_s), *effort)[0]

    def impulse(self, *, rest: int, length: int, size: int = IMPULSE, place: int = 0) -> Vector:
        """Return the velocities per count for an impulse of `size` counts at `place` (counts) after `rest` samples."""
        counts = np.full(rest + length, place, np.int64)
        counts[rest] += size
        return self.motion(counts)[rest:] / size


def _settled_response(probe: _Probe) -> tuple[int, Vector]:
    """Return the number of samples after which the impulse response no longer depends on time, and the response h."""
    length = FIRST_LENGTH
    while True:
        h = probe.impulse(rest=FIRST_REST, length=length)
        if np.abs(h[length // 2 :]).max() <= FADED * np.abs(h).max() or length >= LONGEST_LENGTH:
            break
        length *= 4
    # The response of a recursive Kalman filter, which is linear, is constant only after the filter has settled.
    rest = FIRST_REST
    while True:
        h = probe.impulse(rest=rest, length=length)
        if rest >= LONGEST_REST or _are_close(
            h, probe.impulse(rest=rest + LATER, length=length), 0.01 * SAME
        ):
            return rest, h
        rest *= 4


def _nonlinearity(probe: _Probe, rest: int, h: Vector) -> str:
    """Return why an estimator with the impulse response `h` is not linear; empty if it is linear."""
    if not np.isfinite(h).all() or not h.any():
        return "its response to an impulse is zero or not a number"
    length, place = len(h), 0 if probe.of_effort else PLACE
    others = (
        (rest, 1, 0, "the response to a single count differs from that to a large impulse"),
        (rest, -IMPULSE // 3, 0, "the response is not proportional to the size of an impulse"),
        (rest, IMPULSE, place, "the response depends on the position of an impulse"),
        (rest + LATER, IMPULSE, 0, "the response depends on the time of an impulse"),
    )
    for at, size, place, reason in others:
        if not _are_close(h, probe.impulse(rest=at, length=length, size=size, place=place), SAME):
            return reason
    motion = _random_walk(min(length, WANDERING))
    after = probe.motion(np.concatenate([np.zeros(rest, np.int64), motion]))[rest:]
    if not _are_close(np.convolve(motion, h)[: len(motion)], after, SAME):
        return "the response to a motion is not the sum of the responses to its parts"
    return ""


def _random_walk(samples: int) -> NDArray[np.int64]:
    random = np.random.default_rng(1)
    leaps = random.integers(-300, 301, samples) * (random.random(samples) < 0.1)
    return np.asarray(np.cumsum(random.integers(-2, 3, samples) + leaps))


def _are_close(one: Vector, other: Vector, tolerance: float) -> bool:
    return bool(np.abs(one - other).max() <= tolerance * np.abs(one).max())


def _impulse(a: Matrix, b: Vector, c: Vector, d: float, samples: int) -> Vector:
    h = np.empty(samples)
    h[0] = d
    x = b
    for k in range(1, samples):
        h[k] = c @ x
        x = a @ x
    return h


def _hankel_samples(length: int) -> NDArray[np.int64]:
    """Return the indices of samples for the rows of the Hankel matrix: every sample first, then growing steps."""
    far = np.geomspace(1.0, max(2.0, length), HANKEL).round().astype(np.int64)
    places: NDArray[np.int64] = np.unique(np.concatenate([np.arange(min(LARGEST_ORDER, length)), far]))
    return places[places < length]


def _realise(name: str, h: Vector, period_s: float) -> Realisation:
    peak = np.abs(h).max()
    over = int(np.flatnonzero(np.abs(h) > FADED * peak)[-1]) + 1  # first sample at which h is over
    tail = np.concatenate([h[1:over], np.zeros(max(2 * LARGEST_ORDER, over) + 2)])
    places = _hankel_samples(max(LARGEST_ORDER, over // 2))
    sums = places[:, None] + places[None, :]
    u, sigma, vt = np.linalg.svd(tail[sums])
    shifted = tail[sums + 1]
    best: Realisation | None = None
    for order in range(LARGEST_ORDER + 1):
        if order and sigma[order - 1] <= 1e-15 * sigma[0]:
            break
        root = np.sqrt(sigma[:order])
        a = (u[:, :order] / root).T @ shifted @ (vt[:order].T / root)
        b, c = root * vt[:order, 0], u[0, :order] * root
        again = _impulse(a, b, c, float(h[0]), over + LARGEST_ORDER)
        error = float(np.abs(again[: len(h)] - h[: len(again)]).max() / peak)
        if np.isfinite(error) and (best is None or error < best.error):
            best = Realisation(a, b, c, float(h[0]), period_s, error, name)
        if best is not None and best.error <= REALISED:
            break
    if best is None or best.error > ACCEPTED:
        raise ConfigError(
            f"estimator {name}: no state space of up to {LARGEST_ORDER} states reproduces its impulse response",
            remedy="choose a higher cut-off or a lower order of its filter; or use a simulation",
        )
    return best
