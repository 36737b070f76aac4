"""How well describing functions predict the limit cycle of the encoder's quantum: beside the same walls, simulated.

**The walls** (stated before any result): under each scheme B at `DAMPINGS` of its B_max, and K at `STIFFNESSES` of
K_max there, both of the linear theory; nobody holds the handle. Each is a wall on both sides, held at rest by a push
into it that rests `DEPTH` counts deep, half-way between two counts: that buzzes most. Each is simulated from there for
`SETTLE_S`, then measured for `MEASURED_S`, once with the rig's friction and once without.

**What is measured**: the sinusoid that fits the encoder's side best, its amplitude and frequency, and its share of the
motion's variance. A wall *rests* where no count changes any more. **The errors** are predicted over measured, less one,
over the walls where both have a cycle; where only one of both has one is counted apart. Where the sinusoid has less
than `PURE` of the variance, the motion is none, and the wall is counted as such and its errors given apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.analysis import theory
from rig.analysis.theory import LimitCycle
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.present import Item, Row, Table, reported, written
from rig.core.shown import Shown
from rig.experiments.compare import Start, simulate

DAMPINGS, STIFFNESSES = (0.0, 0.25, 0.5, 0.75), (0.25, 0.5, 0.75)
DEPTH, OFFSET = 3.5, 0.5  # counts
SETTLE_S, MEASURED_S = 8.0, 2.0
PURE = 0.9

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sinusoid:
    """The sinusoid in a motion: amplitude (count), frequency, and its share of the variance; amplitude 0 at rest."""

    amplitude: float
    frequency_hz: float
    share: float

    @classmethod
    def of(cls, counts: Floats, rate_hz: float) -> Sinusoid:
        """The strongest one of a motion about its mean."""
        x = counts - counts.mean()
        spectrum = np.abs(np.fft.rfft(x * np.hanning(len(x))))
        peak = int(np.argmax(spectrum[1:-1])) + 1
        below, at, above = np.log(np.maximum(spectrum[peak - 1 : peak + 2], 1e-300))
        bend = below - 2.0 * at + above
        frequency = (peak + (0.5 * (below - above) / bend if bend else 0.0)) * rate_hz / len(x)
        turn = 2.0 * np.pi * frequency * np.arange(len(x)) / rate_hz
        basis = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        fitted, *_ = np.linalg.lstsq(basis, x, rcond=None)
        share = float(np.var(basis @ fitted) / np.var(x)) if x.any() else 0.0
        return cls(amplitude=float(np.hypot(*fitted)), frequency_hz=float(frequency), share=share)


AT_REST = Sinusoid(amplitude=0.0, frequency_hz=0.0, share=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """One wall held at rest: predicted and simulated."""

    scheme: str
    damping: float
    stiffness: float
    friction: bool
    predicted: LimitCycle
    simulated: Sinusoid

    @reported
    def amplitude_error(self) -> float | None:
        """Predicted over simulated amplitude, less one; None unless both have a cycle."""
        return self.predicted.amplitude / self.simulated.amplitude - 1.0 if self._both else None

    @reported
    def frequency_error(self) -> float | None:
        """Likewise of the frequency."""
        return self.predicted.frequency_hz / self.simulated.frequency_hz - 1.0 if self._both else None

    @property
    def _both(self) -> bool:
        return self.predicted.found and self.simulated.amplitude > 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Relative errors over some walls: how many walls, median of the magnitudes, and the largest."""

    walls: int
    amplitude: tuple[float, float]
    frequency: tuple[float, float]

    @classmethod
    def of(cls, walls: Sequence[Held]) -> Errors:
        """Errors of walls that have both cycles."""

        def spread(errors: list[float]) -> tuple[float, float]:
            sizes = np.abs(errors)
            return (
                (float(np.median(sizes)), float(sizes.max())) if len(sizes) else (float("nan"), float("nan"))
            )

        return cls(
            walls=len(walls),
            amplitude=spread([wall.amplitude_error or 0.0 for wall in walls]),
            frequency=spread([wall.frequency_error or 0.0 for wall in walls]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """How the prediction did, with the rig's friction or without.

    Attributes
    ----------
    sinusoids, others
        Errors where the motion is a sinusoid and where it is none.
    both_rest
        Walls without a cycle, predicted and simulated.
    only_predicted, only_simulated
        Walls where one of both has one.
    """

    friction: bool
    sinusoids: Errors
    others: Errors
    both_rest: int
    only_predicted: int
    only_simulated: int


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class LimitCycles(Shown):
    """Every wall, without friction and with it."""

    rig: str
    walls: tuple[Held, ...]

    @reported
    def tallies(self) -> tuple[Tally, ...]:
        """Without friction, then with it."""
        return tuple(self.tally(friction) for friction in (False, True))

    def tally(self, friction: bool) -> Tally:
        """Count one half of the walls."""
        walls = [wall for wall in self.walls if wall.friction is friction]
        both = [wall for wall in walls if wall.amplitude_error is not None]
        moving = [wall.simulated.amplitude > 0.0 for wall in walls]
        found = [wall.predicted.found for wall in walls]
        return Tally(
            friction=friction,
            sinusoids=Errors.of([wall for wall in both if wall.simulated.share >= PURE]),
            others=Errors.of([wall for wall in both if wall.simulated.share < PURE]),
            both_rest=sum(not m and not f for m, f in zip(moving, found, strict=True)),
            only_predicted=sum(f and not m for m, f in zip(moving, found, strict=True)),
            only_simulated=sum(m and not f for m, f in zip(moving, found, strict=True)),
        )

    def brief(self) -> list[Item]:
        """The errors."""
        return [
            f"limit cycles of the quantum on {self.rig}, predicted and simulated",
            *map(_row, self.tallies),
        ]

    def detailed(self) -> list[Item]:
        """The errors, and every wall."""
        head = ("scheme", "B", "K", "friction", "counts", "Hz", "simulated: counts", "Hz", "sinusoid")
        rows = [
            (
                wall.scheme,
                *(written(value, 3) for value in (wall.damping, wall.stiffness)),
                "yes" if wall.friction else "no",
                *(written(value, 3) for value in (wall.predicted.amplitude, wall.predicted.frequency_hz)),
                *(written(value, 3) for value in (wall.simulated.amplitude, wall.simulated.frequency_hz)),
                f"{100.0 * wall.simulated.share:.0f} %",
            )
            for wall in self.walls
        ]
        return [*self.brief(), Table(head, rows)]


def _row(tally: Tally) -> Row:
    def said(errors: Errors, what: str) -> str:
        (a, worst_a), (f, worst_f) = errors.amplitude, errors.frequency
        return (
            f"{errors.walls} {what}: amplitude {100 * a:.2g} % off (at most {100 * worst_a:.2g} %), "
            f"frequency {100 * f:.2g} % (at most {100 * worst_f:.2g} %)"
        )

    parts = [said(tally.sinusoids, "sinusoids")] if tally.sinusoids.walls else []
    parts += [said(tally.others, "that are none")] if tally.others.walls else []
    parts += [f"{tally.both_rest} rest in both"] if tally.both_rest else []
    parts += [f"{tally.only_predicted} predicted that rest"] if tally.only_predicted else []
    parts += [f"{tally.only_simulated} simulated without a prediction"] if tally.only_simulated else []
    return Row("with friction" if tally.friction else "without friction", "; ".join(parts))


def limit_cycles(experiment: Experiment, schemes: Sequence[Scheme] = ()) -> LimitCycles:
    """Predict and simulate the walls of this module under schemes; the experiment's and the uniform ones if empty.

    Raises
    ------
    ConfigError, NotLinearError
        A scheme that cannot be, or is not linear.
    """
    bare = replace(experiment, trial=replace(experiment.trial, kind="constant-effort"))
    chosen = tuple(schemes) or theory.default_schemes(bare)
    return LimitCycles(
        rig=experiment.rig.name, walls=tuple(wall for scheme in chosen for wall in _of_scheme(bare, scheme))
    )


def _of_scheme(experiment: Experiment, scheme: Scheme) -> list[Held]:
    loop = theory.linear_loop(experiment, scheme)
    lifted = theory.Lifted.of(loop)
    dampings = [share * theory.b_max(lifted).damping for share in DAMPINGS]
    walls = [
        (limit.damping, share * limit.stiffness)
        for limit in theory.k_max_curve(lifted, None, dampings)
        for share in STIFFNESSES
    ]
    return [
        Held(
            scheme=scheme.label(experiment),
            damping=b,
            stiffness=k,
            friction=friction,
            predicted=theory.limit_cycle(loop, None, k, b, duty=DEPTH % 1.0, friction=friction),
            simulated=simulated(scheme.applied(experiment), k, b, friction=friction),
        )
        for b, k in walls
        for friction in (False, True)
    ]


def simulated(experiment: Experiment, stiffness: float, damping: float, *, friction: bool) -> Sinusoid:
    """What a wall does that is held at rest `DEPTH` counts deep, after `SETTLE_S`."""
    rig, side = experiment.rig, experiment.wall.side
    if not friction:
        rig = replace(rig, mechanics=replace(rig.mechanics, motor_coulomb=0.0, link_coulomb=0.0))
    wall = replace(experiment.wall, stiffness=stiffness, damping=damping, law="bilateral", position=0.0)
    trial = replace(experiment.trial, duration_s=SETTLE_S + MEASURED_S)
    count = rig.encoder.resolution
    start = Start(
        position=side * (DEPTH + 0.5 - OFFSET) * count, external_effort=side * DEPTH * count * stiffness
    )
    _, plant, trace = simulate(replace(experiment, rig=rig, wall=wall, trial=trial), start, OFFSET)
    last = round(MEASURED_S * experiment.controller.position_rate)
    if not np.diff(trace.counts[-last:]).any():
        return AT_REST
    return Sinusoid.of(
        trace.states[-last:, plant.sensed_position] / count, float(experiment.controller.position_rate)
    )
