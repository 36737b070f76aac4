"""The fixed-point law in exact arithmetic, and golden vectors computed by it: counts in, current quanta out.

It shares only the integers that the host designed with the compiled law: sums are Python's integers, divisions are
fractions, rounding is `math.floor`, so that no word length can hide an error. A firmware that gives the quanta of
`golden_vectors` for several seeds renders the wall of this project, to the bit.
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from random import Random

from rig.control._fixed_point import ROUNDINGS, Biquad
from rig.control._fixed_wall import DEPTH, FixedWall, design_wall
from rig.control.estimators import get
from rig.control.estimators._fdm_butterworth_fixed import biquad


def rounded(value: Fraction, rounding: int) -> int:
    """Round an exact value to an integer by the named rule."""
    name = ROUNDINGS[rounding]
    if name == "floor":
        return math.floor(value)
    return int(value) if name == "zero" else math.floor(value + Fraction(1, 2))


def clipped(value: int, word_bits: int) -> int:
    """Saturate a value to a two's complement word."""
    return sorted((-(2 ** (word_bits - 1)), value, 2 ** (word_bits - 1) - 1))[1]


def difference(newer: int, older: int) -> int:
    """Return the difference of two counts of a 32-bit counter across its wrap."""
    d = (newer - older) % 2**32
    return d - 2**32 if d >= 2**31 else d


class ExactFilter:
    """Finite difference and biquad in exact arithmetic, called once for each velocity sample."""

    def __init__(self, filter_: Biquad) -> None:
        self.filter = filter_
        self.count: int | None = None
        self.inputs, self.outputs = [0, 0], [0, 0]

    def velocity(self, count: int, elapsed: int = 1) -> int:
        """Return the velocity in counts per period (LSB of the state)."""
        f = self.filter
        moved = 0 if self.count is None else difference(count, self.count)
        self.count = count
        word, scale = f.state.word_bits, 2**f.state.fraction_bits
        x = clipped(rounded(Fraction(moved * scale, elapsed), f.rounding), word)
        for _ in range(min(elapsed, 1000)):
            terms = zip((f.b0, f.b1, f.b2, -f.a1, -f.a2), (x, *self.inputs, *self.outputs), strict=True)
            total = Fraction(sum(c * s for c, s in terms), 2**f.coefficient_bits)
            self.inputs = [x, self.inputs[0]]
            self.outputs = [clipped(rounded(total, f.rounding), word), self.outputs[0]]
        return self.outputs[0]


def exact_quanta(count: int, velocity: int, wall: FixedWall) -> int:
    """Return the guarded current of wall and constant effort (quanta)."""
    depth = wall.direction * difference(count, wall.reference) * 2**DEPTH.fraction_bits - wall.surface
    depth = clipped(depth, DEPTH.word_bits)
    reaction = 0
    if depth > 0:
        inwards = wall.direction * velocity
        if wall.entry_only:
            inwards = max(inwards, 0)
        reaction = wall.stiffness * depth + wall.damping * inwards
        if not wall.may_pull:
            reaction = max(reaction, 0)
    total = Fraction(wall.constant - wall.side * reaction, 2**wall.shift)
    return sorted((-wall.limit, math.floor(total + Fraction(1, 2)), wall.limit))[1]


@dataclass(frozen=True)
class GoldenVectors:
    """One trial: the parameters of the law, the count of each tick, and the required currents."""

    filter: Biquad
    wall: FixedWall
    velocity_divider: int
    counts: tuple[int, ...]

    @cached_property
    def velocities(self) -> tuple[int, ...]:
        """The velocity held in each tick (LSB of the filter's state); one tick in `velocity_divider` has a new one."""
        exact, divider = ExactFilter(self.filter), self.velocity_divider
        taken = [exact.velocity(count) for count in self.counts[::divider]]
        return tuple(taken[tick // divider] for tick in range(len(self.counts)))

    @cached_property
    def quanta(self) -> tuple[int, ...]:
        """The required current for each count."""
        held = zip(self.counts, self.velocities, strict=True)
        return tuple(exact_quanta(count, velocity, self.wall) for count, velocity in held)


@cache
def golden_vectors(seed: int, ticks: int = 400) -> GoldenVectors:
    """Return the vectors of a seed; they never change, because `Random.random` is guaranteed by Python.

    The seed draws rates, filter, wall and options; the handle hits the wall, rings, jumps now and then, and in every
    fourth seed crosses the wrap of the counter.
    """
    random = Random(seed)

    def between(low: float, high: float) -> float:
        return low + (high - low) * random.random()

    def one_of(*values: float) -> float:
        return values[int(random.random() * len(values))]

    divider = int(one_of(1, 1, 2, 5, 10))
    period_s = divider / one_of(1000, 10_000, 20_000)
    settings: dict[str, float | str] = {
        "cutoff_hz": one_of(0.05, 0.1, 0.2) / period_s,
        "coefficient_bits": one_of(12, 14, 24),
        "state_bits": one_of(2, 4, 8, 16),
        "word_bits": 32,
        "rounding": ROUNDINGS[int(random.random() * 3)],
        "numerator": "unit-gain" if random.random() < 0.5 else "nearest",
    }
    get("fdm-butterworth-fixed").prepare(settings, 1.0, period_s)  # refuses what cannot be meant
    filter_ = biquad(settings, period_s)
    sign, side = one_of(-1, 1), int(one_of(-1, 1))
    delta, quantum = 1.5707963e-4, 2.34e-4
    reference = 2**31 - 40 if seed % 4 == 0 else int(between(-1000, 1000))
    wall = design_wall(
        stiffness=between(1, 100) * quantum / delta,
        damping=between(1, 300) * quantum * period_s / delta,
        resolution=sign * delta,
        period_s=period_s,
        velocity=filter_.state,
        effort_quantum=quantum,
        effort_limit=1.3,
        wall_position=between(-0.002, 0.002),
        side=side,
        constant_effort=side * between(0, 0.3),
        reference_count=reference,
        may_pull=random.random() < 0.5,
        entry_only=random.random() < 0.5,
    )
    counts = []
    for k in range(ticks):
        ring = 8 - 60 * math.exp(-k / 80) * math.sin((60 - k) * 0.07)
        place = k - 52 if k < 60 else ring + between(-1, 1)
        jump = between(-5000, 5000) if random.random() < 0.02 else 0.0
        counts.append(difference(reference + wall.direction * round(place + jump), 0))
    return GoldenVectors(filter_, wall, divider, tuple(counts))
