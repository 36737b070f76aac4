"""Fit cogging to slow sweeps: half the sum of the efforts up and down is cogging, half the difference is friction.

While the handle moves slowly through x, the motor's command is −F(x) + friction upwards and −F(x) − friction downwards;
F is the effort of cogging. The efforts of inertia and damping are subtracted, because no servo keeps the speed exactly
constant. F is a sum of harmonics of a period, fitted to each pair of sweeps (up and down) separately. The pairs differ
in speed, so effects that depend on speed widen the intervals, as noise does. A constant external effort is not part of
cogging: it appears in the friction levels, which `rig.analysis.identification._sliding` measures better.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rig.analysis.identification._interval import Interval, from_scatter, quantile
from rig.analysis.identification._quality import IdentificationError
from rig.analysis.identification._sliding import Stroke
from rig.core.model import Cogging
from rig.core.present import reported

Floats = NDArray[np.float64]

# Points of a fit in one wave of the highest order; each point is the mean of a block of samples.
BLOCKS = 64
# Time left out at both ends of a sweep (s), in which the servo changes its speed.
SETTLE_S = 0.3
# An order is significant if its amplitude is this many times its interval …
CERTAIN = 2.0
# … and this share of the largest amplitude.
SHARE = 0.02
# With fewer periods of cogging in the range, harmonics cannot be separated.
LEAST_PERIODS = 1.0


@dataclass(frozen=True, eq=False)
class CoggingMap:
    """Cogging of a motor: effort over position, as fitted by `fit_cogging`.

    Attributes
    ----------
    period
        Fundamental period of the harmonics (rad or m).
    orders, cosine, sine
        Orders of the identified harmonics, and their amplitudes (N·m or N); see `rig.core.model.Cogging`.
    minimum, maximum
        Range of positions in which the harmonics were measured (rad or m).
    ci95
        Half width of the 95 % interval of the map at the position where it is widest (N·m or N).
    unseen
        Largest amplitude that a harmonic not listed in `orders` may have (N·m or N).
    friction
        Friction: the mean over a period of half the difference of the efforts up and down (N·m or N). If it varies with
        position, the interval includes what torque ripple as its cause would add to the mean.
    position, effort, rubbing
        Positions in the range (rad or m), measured cogging (half the sum of the efforts up and down, N·m or N) and
        measured friction (half their difference, N·m or N) at these positions, shape (n,).
    """

    period: float
    orders: tuple[int, ...]
    cosine: tuple[Interval, ...]
    sine: tuple[Interval, ...]
    minimum: float
    maximum: float
    ci95: float
    unseen: float
    friction: Interval
    position: Floats = field(repr=False)
    effort: Floats = field(repr=False)
    rubbing: Floats = field(repr=False)

    @property
    def cogging(self) -> Cogging:
        """Return the fitted harmonics of cogging in the form of a rig's description (`rig.core.model.Cogging`)."""
        return Cogging(
            period=self.period,
            orders=self.orders,
            cosine=tuple(c.value for c in self.cosine),
            sine=tuple(s.value for s in self.sine),
            minimum=self.minimum,
            maximum=self.maximum,
        )

    @reported
    def peak(self) -> float:
        """Return the largest absolute effort of cogging (N·m or N) in the measured range of positions."""
        return float(np.abs(self.cogging.effort(self._range)).max())

    @reported
    def stiffness(self) -> tuple[float, float]:
        """Return smallest and largest slope of the cogging effort over position in the range (N·m/rad or N/m)."""
        stiffness = -self.cogging.slope(self._range)
        return float(stiffness.min()), float(stiffness.max())

    @property
    def _range(self) -> Floats:
        return np.linspace(self.minimum, self.maximum, 2001)


def fit_cogging(
    time_s: Floats,
    effort: Floats,
    position: Floats,
    sweeps: Sequence[Stroke],
    *,
    period: float,
    most_order: int,
    inertia: float,
    damping: float,
) -> CoggingMap:
    """Fit a map of cogging to slow sweeps.

    Parameters
    ----------
    time_s, effort, position
        Time (s), commanded effort (N·m or N) and position (rad or m) of the whole run, shape (n,), evenly sampled; the
        times of `sweeps` have the same origin.
    sweeps
        Commanded sweeps in pairs, up and then down, over the same travel.
    period
        Period of the harmonics (rad or m).
    most_order
        Highest order of harmonic to search.
    inertia, damping
        Total inertia (kg·m² or kg) and damping (N·m·s/rad or N·s/m, with back-EMF under voltage drive) of all moving
        parts.

    Raises
    ------
    IdentificationError
        The handle moved in fewer than two pairs, or the range that all sweeps covered is shorter than a period.
    """
    wave = period / most_order
    pairs = pairs_of(time_s, effort, position, sweeps, wave=wave, inertia=inertia, damping=damping)
    low, high = common_range(pairs, period)
    pairs = [within(pair, low, high) for pair in pairs]
    orders, unseen = _orders(pairs, period, most_order)
    each = np.array([fitted_pair(pair, period, orders) for pair in pairs])
    every = [from_scatter(float(column.mean()), column) for column in each.T]
    bias, n = float(each[:, -2:].mean()), len(orders)
    at, up, down = _mean_efforts(pairs, low, high, wave)
    maps = np.array([basis(at, period, orders) @ row[: 2 * n] for row in each])
    factor = quantile(len(pairs) - 1) / math.sqrt(len(pairs))
    return CoggingMap(
        period=period,
        orders=orders,
        cosine=tuple(every[:n]),
        sine=tuple(every[n : 2 * n]),
        minimum=float(low),
        maximum=float(high),
        ci95=factor * float(maps.std(axis=0, ddof=1).max()),
        unseen=unseen,
        friction=_mean_friction(pairs, period, most_order),
        position=at,
        effort=0.5 * (up + down) - bias,
        rubbing=0.5 * (down - up),
    )


Points = tuple[Floats, Floats]
Pair = tuple[Points, Points]  # up, down


def pairs_of(
    time_s: Floats,
    effort: Floats,
    position: Floats,
    sweeps: Sequence[Stroke],
    *,
    wave: float,
    inertia: float,
    damping: float,
) -> list[Pair]:
    """Return for each pair of sweeps (up, down) arrays of position (rad or m) and of cogging minus friction (N·m or N).

    `wave` is the shortest period of a harmonic to fit (rad or m), of which a 64th is averaged to one point. Raise
    `IdentificationError` if the handle moved in fewer than two pairs.
    """
    ways = [_points(time_s, effort, position, sweep, wave, inertia, damping) for sweep in sweeps]
    if len(ways) < 4 or min(len(x) for x, _ in ways) == 0:
        raise IdentificationError(
            "the handle moved in fewer than two pairs of sweeps; at least two are needed",
            remedy="keep everything off the handle, and allow more effort (rig.limits.effort)",
        )
    return list(zip(ways[::2], ways[1::2], strict=True))


def common_range(pairs: Sequence[Pair], period: float) -> tuple[float, float]:
    """Return the lowest and the highest position (rad or m) of the range that all sweeps covered.

    Raise `IdentificationError` if the range is shorter than `period` (rad or m), the period of cogging.
    """
    ways = [x for pair in pairs for x, _ in pair]
    low, high = max(float(x.min()) for x in ways), min(float(x.max()) for x in ways)
    if high - low < LEAST_PERIODS * period:
        raise IdentificationError(
            f"the sweeps cover a common range of {high - low:.4g} rad or m; at least a period of cogging, "
            f"{period:.4g}, is needed to separate its harmonics",
            remedy="widen the window of positions, or correct rig.cogging.period if the true period is shorter",
        )
    return low, high


def within(pair: Pair, low: float, high: float) -> Pair:
    """Return the points (positions, efforts) of both sweeps of a pair between positions `low` and `high` (rad or m)."""
    up, down = ((x[(x >= low) & (x <= high)], y[(x >= low) & (x <= high)]) for x, y in pair)
    return up, down


def _points(
    time_s: Floats,
    effort: Floats,
    position: Floats,
    sweep: Stroke,
    wave: float,
    inertia: float,
    damping: float,
) -> Points:
    tick_s = float(time_s[1] - time_s[0])
    n = max(1, round(wave / abs(sweep.velocity) / BLOCKS / tick_s))
    inside = (time_s >= sweep.begin_s + SETTLE_S) & (time_s < sweep.end_s - SETTLE_S)
    chosen = np.flatnonzero(inside)
    blocks = chosen[: len(chosen) // n * n].reshape(-1, n)
    if len(blocks) < BLOCKS:
        return np.empty(0), np.empty(0)
    x, u, block_s = position[blocks].mean(axis=1), effort[blocks].mean(axis=1), n * tick_s
    acceleration, velocity = np.diff(x, 2) / block_s**2, (x[2:] - x[:-2]) / (2.0 * block_s)
    return x[1:-1], inertia * acceleration + damping * velocity - u[1:-1]


def basis(x: Floats, period: float, orders: Sequence[int]) -> Floats:
    """Return the cosines, then the sines of all harmonics at positions `x` (rad or m), shape (n, 2·len(orders))."""
    angle = 2.0 * math.pi / period * np.multiply.outer(x, np.asarray(orders, dtype=np.float64))
    return np.hstack([np.cos(angle), np.sin(angle)])


def fitted_pair(pair: Pair, period: float, orders: Sequence[int]) -> Floats:
    """Fit cogging to two sweeps; return amplitudes of cosines, of sines, mean effort up, mean down (N·m or N)."""
    up, down = pair
    rows = [
        np.column_stack(
            [basis(x, period, orders), np.full(len(x), float(rises)), np.full(len(x), float(not rises))]
        )
        for (x, _), rises in ((up, True), (down, False))
    ]
    found: Floats = np.linalg.lstsq(np.vstack(rows), np.concatenate([up[1], down[1]]), rcond=None)[0]
    return found


def _mean_friction(pairs: Sequence[Pair], period: float, most: int) -> Interval:
    # A range that is no whole number of periods mixes harmonics into the mean unless they are fitted, too.
    found = []
    for up, down in pairs:
        rising, falling = (
            np.column_stack([basis(x, period, range(1, most + 1)), np.ones(len(x))]) for x, _ in (up, down)
        )
        rows = np.block([[rising, -rising], [falling, falling]])
        found.append(np.linalg.lstsq(rows, np.concatenate([up[1], down[1]]), rcond=None)[0][2 * most + 1 :])
    *amplitudes, levels = np.array(found).T
    mean = from_scatter(float(levels.mean()), levels)
    # Under ripple r the difference is friction/(1 + r), whose mean is larger than friction by the mean of r².
    variance = 0.5 * sum(float(amplitude.mean()) ** 2 for amplitude in amplitudes)
    return Interval(mean.value, mean.ci95 + (variance / abs(mean.value) if variance else 0.0))


def _orders(pairs: Sequence[Pair], period: float, most: int) -> tuple[tuple[int, ...], float]:
    """Return the significant orders of cogging, and the largest amplitude of any other order (N·m or N)."""
    every = range(1, most + 1)
    each = np.array([fitted_pair(pair, period, every) for pair in pairs])[:, : 2 * most]
    mean, spread = each.mean(axis=0), each.std(axis=0, ddof=1)
    amplitude = np.hypot(mean[:most], mean[most:])
    half = quantile(len(pairs) - 1) / math.sqrt(len(pairs)) * np.hypot(spread[:most], spread[most:])
    needed = np.maximum(CERTAIN * half, SHARE * amplitude.max())
    sure = amplitude >= needed
    return tuple(int(n) for n in np.flatnonzero(sure) + 1), float(needed[~sure].max(initial=0.0))


def _mean_efforts(
    pairs: Sequence[Pair], low: float, high: float, wave: float
) -> tuple[Floats, Floats, Floats]:
    """Return centres of position bins, and the mean effort in each bin over all upward and all downward sweeps."""
    edges = np.linspace(low, high, max(2, round(8.0 * (high - low) / wave)) + 1)
    means = []
    for way in (0, 1):
        x = np.concatenate([pair[way][0] for pair in pairs])
        y = np.concatenate([pair[way][1] for pair in pairs])
        held, total = np.histogram(x, edges)[0], np.histogram(x, edges, weights=y)[0]
        means.append(np.where(held > 0, total / np.maximum(held, 1), np.nan))
    at = np.array([0.5 * (a + b) for a, b in pairwise(edges)])
    return at, means[0], means[1]
