"""Compute the stability limits of a wall: K_max over B, B_max, islands of stability, and maps over K and B.

Stability is not monotone in K. A limit is the end of the *connected* stable range that begins at the lowest stiffness;
stable ranges above the limit (islands) are listed. A scan detects islands wider than its step (8 % of K); their ends
are found by bisection. If the range reaches the end of the scan, the limit is marked as capped, because it is not a
result.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.analysis.theory._lifted import Lifted
from rig.analysis.theory._loop import RigLike, SchemeLike, linear_loop
from rig.core.errors import ConfigError
from rig.core.model import Operator

Vector = NDArray[np.float64]
Flags = NDArray[np.bool_]

POINTS = 200  # stiffnesses, or dampings, of a scan
LOWEST_HZ = 1.0
# Bisections of one step of a scan: the remaining error is far below rounding.
BISECTIONS = 30
ISLAND_DAMPINGS, ISLAND_STIFFNESSES, ISLAND_BISECTIONS = 24, 120, 12  # of the search for islands beyond B_max
# The search for islands ends at this multiple of B_max.
ISLAND_REACH = 4.0
# The scan for B_max ends at 8·J/T2 and covers five decades below.
DAMPING_REACH, DAMPING_DECADES = 8.0, 5.0


@dataclass(frozen=True, slots=True)
class Island:
    """A stable range of stiffness (N·m/rad or N/m) above an unstable one; `capped` if the search ended within it."""

    low: float
    high: float
    capped: bool


@dataclass(frozen=True, slots=True)
class Limit:
    """Largest stable stiffness at one damping of the wall.

    Attributes
    ----------
    damping, stiffness
        Damping B (N·m·s/rad or N·s/m), and end of the stable range that begins at the lowest stiffness of the scan
        (N·m/rad or N/m); 0 if the lowest stiffness is unstable.
    frequency_hz
        Frequency of the mode that becomes unstable at the limit (Hz); NaN if capped.
    capped
        True if the stable range reaches the end of the scan: `stiffness` is that end and not a limit.
    islands
        Stable ranges of stiffness above the limit.
    """

    damping: float
    stiffness: float
    frequency_hz: float
    capped: bool
    islands: tuple[Island, ...] = ()

    @property
    def highest(self) -> float:
        """Return the largest stable stiffness (N·m/rad or N/m), islands (ranges above the limit) included."""
        return self.islands[-1].high if self.islands else self.stiffness


@dataclass(frozen=True, slots=True)
class DampingLimit:
    """Largest stable damping of a wall.

    Attributes
    ----------
    damping
        End of the range of B, from zero up, in which the lowest stiffness is stable (N·m·s/rad or N·s/m).
    frequency_hz
        Frequency of the mode that becomes unstable at the limit (Hz); NaN if capped.
    capped
        True if the stable range reaches the end of the scan: `damping` is that end and not a limit.
    with_islands, island_stiffness
        Largest damping at which some stiffness is stable (N·m·s/rad or N·s/m), and such a stiffness (N·m/rad or N/m).
        Above `damping` only islands of stiffness are stable.
    """

    damping: float
    frequency_hz: float
    capped: bool
    with_islands: float
    island_stiffness: float


@dataclass(frozen=True, slots=True, eq=False)
class StabilityMap:
    """Spectral radius over a grid of walls: ``radius[i, j]`` at ``stiffnesses[i]`` and ``dampings[j]``."""

    stiffnesses: Vector
    dampings: Vector
    radius: Vector

    @property
    def stable(self) -> Flags:
        """Return True for each wall of the grid that is linearly stable, in the shape of `radius`."""
        return np.asarray(self.radius < 1.0)


def k_max(
    rig: RigLike | Lifted,
    scheme: SchemeLike | None = None,
    damping: float = 0.0,
    *,
    operator: str | Operator | None = None,
) -> Limit:
    """Return the largest stable stiffness of a virtual wall at a damping (N·m·s/rad or N·s/m), by linear theory.

    `rig` is a preset's name, a path, an experiment or a model; `scheme` a text such as ``dual:20k/2k`` (None: that of
    the experiment); `operator` the grip of a modelled hand. Raise `ConfigError` if one is invalid or the loop is not
    linear.
    """
    return k_max_curve(rig, scheme, [damping], operator=operator)[0]


def k_max_curve(
    rig: RigLike | Lifted,
    scheme: SchemeLike | None,
    dampings: Sequence[float] | Vector,
    *,
    operator: str | Operator | None = None,
) -> tuple[Limit, ...]:
    """Return the largest stable stiffness of a virtual wall at each of `dampings` (N·m·s/rad or N·s/m, finite)."""
    lifted = as_lifted(rig, scheme, operator)
    b = _dampings(dampings)
    k = stiffnesses(lifted, float(b.max(initial=0.0)))
    stable = lifted.stable(k, b[:, None])
    # Every change of stability and not only the first: near the end of the range of damping low stiffnesses fail first
    # and an island of stable ones remains.
    row, column = np.nonzero(stable[:, :-1] != stable[:, 1:])
    edges = _between(lifted, k[column], k[column + 1], b[row], stable[row, column])
    return tuple(
        _limit(lifted, float(b[i]), k, edges[row == i].tolist(), bool(stable[i, 0])) for i in range(len(b))
    )


def b_max(
    rig: RigLike | Lifted, scheme: SchemeLike | None = None, *, operator: str | Operator | None = None
) -> DampingLimit:
    """Return a virtual wall's largest stable damping, with and without ranges of stiffness above an unstable one."""
    lifted = as_lifted(rig, scheme, operator)
    damping, lowest, highest = damping_range(lifted), _lowest_stiffness(lifted), _highest_damping(lifted)
    if damping == highest:
        return DampingLimit(highest, math.nan, True, highest, lowest)
    islands, stiffness = _last_island(lifted, damping, highest)
    beyond = damping * (1.0 + 1e-6) if damping else highest * 10.0**-DAMPING_DECADES
    return DampingLimit(damping, lifted.frequency(lowest, beyond), False, islands, stiffness)


def damping_range(rig: RigLike | Lifted, scheme: SchemeLike | None = None) -> float:
    """Return `b_max(…).damping` in a third of the time: islands are not searched for."""
    lifted = as_lifted(rig, scheme)
    lowest, highest = _lowest_stiffness(lifted), _highest_damping(lifted)
    b = highest * np.geomspace(10.0**-DAMPING_DECADES, 1.0, POINTS)
    unstable = np.flatnonzero(~lifted.stable(lowest, b))
    if len(unstable) == 0 or unstable[0] == 0:
        return highest if len(unstable) == 0 else 0.0
    low, high = b[unstable[0] - 1], b[unstable[0]]
    for _ in range(BISECTIONS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if lifted.radius(lowest, middle) < 1.0 else (low, middle)
    return float(low)


def stability_map(
    rig: RigLike | Lifted,
    scheme: SchemeLike | None,
    stiffnesses: ArrayLike,
    dampings: ArrayLike,
    *,
    operator: str | Operator | None = None,
) -> StabilityMap:
    """Return the spectral radius at each pair of `stiffnesses` and `dampings` (SI); below 1 the wall is stable."""
    k, b = np.asarray(stiffnesses, float).ravel(), np.asarray(dampings, float).ravel()
    return StabilityMap(k, b, as_lifted(rig, scheme, operator).radius(k[:, None], b))


def as_lifted(
    rig: RigLike | Lifted, scheme: SchemeLike | None, operator: str | Operator | None = None
) -> Lifted:
    """Return a rig's loop as transition from one velocity sample to the next; a `Lifted` is returned unchanged."""
    if isinstance(rig, Lifted):
        return rig
    return Lifted.of(linear_loop(rig, scheme, operator=operator))


def stiffnesses(lifted: Lifted, damping: float) -> Vector:
    """Return the stiffnesses (N·m/rad or N/m) to test for stability at dampings up to `damping`, in equal ratios."""
    loop = lifted.loop
    # Up to where the motor alone would oscillate at half the position rate, or to what damping could allow.
    motor = loop.subject.model.mechanics.motor_inertia * (math.pi / loop.tick_s) ** 2
    damped = 4.0 * (loop.subject.damping + abs(damping)) / loop.tick_s
    lowest = _lowest_stiffness(lifted)
    return np.geomspace(lowest, max(motor, damped, 10.0 * lowest), POINTS)


def _lowest_stiffness(lifted: Lifted) -> float:
    # The rig's mass would oscillate on it at LOWEST_HZ.
    return lifted.loop.subject.inertia * (2.0 * math.pi * LOWEST_HZ) ** 2


def _highest_damping(lifted: Lifted) -> float:
    return DAMPING_REACH * lifted.loop.subject.inertia / lifted.loop.period_s + lifted.loop.subject.damping


def _dampings(given: Sequence[float] | Vector) -> Vector:
    b = np.asarray(given, float).ravel()
    if not np.isfinite(b).all():
        wrong = float(b[~np.isfinite(b)][0])
        raise ConfigError(f"a wall's damping is {wrong}; it must be finite", remedy="give finite dampings")
    return b


def _between(lifted: Lifted, low: Vector, high: Vector, damping: Vector, stable_below: Flags) -> Vector:
    for _ in range(BISECTIONS):
        middle = np.sqrt(low * high)
        below = (lifted.radius(middle, damping) < 1.0) == stable_below
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(low)


def _limit(lifted: Lifted, damping: float, k: Vector, edges: list[float], stable_below: bool) -> Limit:
    """Return the stiffness limit at one damping, from the stiffnesses `edges` at which the stability changes."""
    end = float(k[-1])
    if stable_below and not edges:
        return Limit(damping, end, math.nan, True)
    stiffness = edges[0] if stable_below else 0.0
    rest = edges[1:] if stable_below else edges
    islands = [
        Island(low, *((rest[i + 1], False) if i + 1 < len(rest) else (end, True)))
        for i, low in enumerate(rest)
        if i % 2 == 0
    ]
    frequency = lifted.frequency(stiffness * (1.0 + 1e-6) if stable_below else float(k[0]), damping)
    return Limit(damping, stiffness, frequency, False, tuple(islands))


def _last_island(lifted: Lifted, damping: float, highest: float) -> tuple[float, float]:
    """Return the largest damping up to `highest` at which some stiffness is stable, and such a stiffness."""
    reach = min(highest, ISLAND_REACH * damping) if damping > 0.0 else highest
    scanned = stiffnesses(lifted, reach)
    k = np.geomspace(float(scanned[0]), float(scanned[-1]), ISLAND_STIFFNESSES)
    tried = np.linspace(damping, reach, ISLAND_DAMPINGS)[1:]
    some = np.flatnonzero(lifted.stable(k, tried[:, None]).any(axis=1))
    last = int(some[-1]) if len(some) else -1
    low = float(tried[last]) if len(some) else damping
    high = float(tried[min(last + 1, len(tried) - 1)])
    for _ in range(ISLAND_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if lifted.stable(k, middle).any() else (low, middle)
    best = int(np.argmin(lifted.radius(k, low))) if low > damping else 0
    return low, float(k[best])
