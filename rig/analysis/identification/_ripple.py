"""Fit the ripple of the motor's effort to slow sweeps without and with a steady load.

A motor produces 1 + r(x) times the commanded effort u. While the handle slides slowly, half the sum of the efforts up
and down is F(x)/(1 + r(x)), with F the effort of cogging, and half the difference is friction/(1 + r(x)). The sum shows
ripple only as a product of two small numbers; the difference cannot separate ripple from friction that varies with
position. A steady load W adds W/(1 + r(x)) to half the sum, whatever cogging and friction are, if they are the same
with and without load. This added effort over its mean gives the ripple, which thus depends neither on W nor on the
described torque constant.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.analysis.identification._cogging import CERTAIN, Pair, basis, common_range, fitted_pair, within
from rig.analysis.identification._interval import Interval, from_scatter
from rig.analysis.identification._quality import IdentificationError
from rig.core.present import reported

Floats = NDArray[np.float64]

# In each round the fit finds the ripple that the previous round has left.
ROUNDS = 3


@dataclass(frozen=True)
class Ripple:
    """Ripple r(x) of a motor: at position x the motor produces 1 + r(x) times the commanded effort.

    Attributes
    ----------
    period
        Fundamental period of the harmonics (rad or m).
    orders, cosine, sine
        Orders of the identified harmonics, and their amplitudes as shares of the effort; see `rig.core.model.Cogging`.
    unseen
        Largest amplitude that a harmonic not listed in `orders` may have, as a share of the effort.
    load
        The steady load, computed with the described torque constant (N·m or N).
    """

    period: float
    orders: tuple[int, ...]
    cosine: tuple[Interval, ...]
    sine: tuple[Interval, ...]
    unseen: float
    load: Interval

    @reported
    def amplitude(self) -> tuple[Interval, ...]:
        """Return the amplitude of each identified harmonic of the torque ripple, as a share of the effort."""
        return tuple(
            Interval(size, math.hypot(c.value * c.ci95, s.value * s.ci95) / size)
            for c, s, size in self._harmonics
        )

    @reported
    def phase(self) -> tuple[Interval, ...]:
        """Return the phase (rad) of each identified harmonic of the ripple; its crest is phase/2π periods from zero."""
        return tuple(
            Interval(math.atan2(s.value, c.value), math.hypot(s.value * c.ci95, c.value * s.ci95) / size**2)
            for c, s, size in self._harmonics
        )

    @property
    def _harmonics(self) -> list[tuple[Interval, Interval, float]]:
        pairs = zip(self.cosine, self.sine, strict=True)
        return [(c, s, math.hypot(c.value, s.value)) for c, s in pairs]


def fit_ripple(free: Sequence[Pair], loaded: Sequence[Pair], *, period: float, most_order: int) -> Ripple:
    """Fit the harmonics of ripple to pairs of sweeps without and with a steady load.

    Parameters
    ----------
    free, loaded
        Pairs of sweeps without and with load, from `rig.analysis.identification._cogging.pairs_of`; equal in number.
    period
        Period of the harmonics (rad or m).
    most_order
        Highest order of harmonic to search.

    Raises
    ------
    IdentificationError
        The common range of the sweeps is shorter than a period, or the load is not larger than its 95 % interval.
    """
    low, high = common_range([*free, *loaded], period)
    every = range(1, most_order + 1)
    by_pair = np.array(  # a row for each pair of sweeps: cosines, sines, load
        [
            _fit_shares(within(without, low, high), within(with_, low, high), period, every)
            for without, with_ in zip(free, loaded, strict=True)
        ]
    )
    load = from_scatter(float(by_pair[:, -1].mean()), by_pair[:, -1])
    if not abs(load.value) > load.ci95:
        raise IdentificationError(
            f"the load was measured as {load.text()} N·m or N: it must be larger than its 95 % interval, "
            "otherwise friction masks the ripple",
            remedy="hang a larger mass, or use a longer arm",
        )
    intervals = [from_scatter(float(column.mean()), column) for column in by_pair.T]
    cosine, sine = intervals[:most_order], intervals[most_order:-1]
    size = np.array([math.hypot(c.value, s.value) for c, s in zip(cosine, sine, strict=True)])
    needed = CERTAIN * np.array([math.hypot(c.ci95, s.ci95) for c, s in zip(cosine, sine, strict=True)])
    sure = np.flatnonzero(size >= needed)
    return Ripple(
        period=period,
        orders=tuple(int(i) + 1 for i in sure),
        cosine=tuple(cosine[i] for i in sure),
        sine=tuple(sine[i] for i in sure),
        unseen=float(needed[size < needed].max(initial=0.0)),
        load=load,
    )


def _fit_shares(free: Pair, loaded: Pair, period: float, orders: Sequence[int]) -> Floats:
    """Return ripple as cosine, then sine amplitudes (shares of the effort), and last the load (N·m or N)."""
    shares, load = np.zeros(2 * len(orders)), 0.0
    for _ in range(ROUNDS):
        without, with_ = (
            fitted_pair(_undo_ripple(pair, shares, period, orders), period, orders) for pair in (free, loaded)
        )
        # What the load adds to the effort; friction is the same with and without it, so it drops out of the difference.
        *harmonics, effort_up, effort_down = with_ - without
        load = -0.5 * (effort_up + effort_down)  # the motor opposes the load
        # To first order the motor needs load/(1 + r) = load·(1 − r): the two signs cancel.
        shares = shares + np.array(harmonics) / load
    return np.array([*shares, load])


def _undo_ripple(pair: Pair, shares: Floats, period: float, orders: Sequence[int]) -> Pair:
    up, down = ((x, y * (1.0 + basis(x, period, orders) @ shares)) for x, y in pair)
    return up, down
