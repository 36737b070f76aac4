"""Compare limit cycles of the encoder's quantisation that describing functions predict with simulated limit cycles.

**Walls**: for each scheme, B is `DAMPINGS` times B_max and K is `STIFFNESSES` times K_max at this B, both by linear
theory; no hand holds the handle. Each wall acts on both sides, against a push that rests `DEPTH` counts deep, half-way
between two counts, where the wall oscillates most. The handle is released `AWAY` counts deeper, moves for `SETTLE_S`
(s), and is measured for `MEASURED_S` (s): with and without friction, and with the effort limit of the wire format only.

**Measured values**: amplitude, √2 times the rms of the encoder's side about its mean; frequency, half of the number of
count changes per second; and the share of the variance within `BAND` of that frequency. These are also defined for a
cycle whose phase wanders, which a fitted line would miss. A wall *rests* if its count no longer changes. **Errors** are
predicted / measured - 1, over the walls where prediction and simulation have a cycle; other walls are counted. If less
than `PURE` of the variance lies in the band, the motion is not a sinusoid, and its errors are listed separately. Errors
of walls with `LimitCycle.alone` (only one predicted frequency) are also listed separately.
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
from rig.control.verdict import percent
from rig.core.errors import PlanError
from rig.core.present import Item, Row, Table, reported, written
from rig.core.shown import Shown
from rig.experiments.hits.compare import Start, simulate
from rig.extras.papers.disagreement.ablation import FRICTION, SATURATION, without

DAMPINGS, STIFFNESSES = (0.0, 0.25, 0.5, 0.75), (0.25, 0.5, 0.75)
DEPTH, AWAY, OFFSET = 3.5, 3.0, 0.5  # counts
SETTLE_S, MEASURED_S = 8.0, 2.0
BAND, PURE = 0.25, 0.9

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cycle:
    """A simulated limit cycle: amplitude (counts), frequency (Hz), share of the variance near it; all 0 at rest."""

    amplitude: float
    frequency_hz: float
    share: float

    @classmethod
    def of(cls, motion: Floats, counts: Ints, rate_hz: float) -> Cycle:
        """Measure the limit cycle of a motion (counts) and of its quantised counts, sampled at `rate_hz`."""
        # Counted, not fitted: it is defined for a cycle whose phase wanders, as toggling between two ticks makes it,
        # where a line fitted over the whole time finds little.
        frequency = 0.5 * np.count_nonzero(np.diff(counts)) * rate_hz / len(counts)
        if frequency == 0.0:
            return cls(amplitude=0.0, frequency_hz=0.0, share=0.0)
        power = np.abs(np.fft.rfft(motion - motion.mean())) ** 2
        hz = np.fft.rfftfreq(len(motion), 1.0 / rate_hz)
        near = np.abs(hz - frequency) <= BAND * frequency
        return cls(
            amplitude=float(np.sqrt(2.0) * motion.std()),
            frequency_hz=float(frequency),
            share=float(power[near].sum() / power.sum()),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldWall:
    """One wall with its predicted and its simulated limit cycle."""

    scheme: str
    damping: float
    stiffness: float
    friction: bool
    predicted: LimitCycle
    simulated: Cycle

    @reported
    def amplitude_error(self) -> float | None:
        """Predicted / simulated amplitude - 1; None without a predicted or without a simulated limit cycle."""
        return self.predicted.amplitude / self.simulated.amplitude - 1.0 if self._both else None

    @reported
    def frequency_error(self) -> float | None:
        """Predicted / simulated frequency - 1; None without a predicted or without a simulated limit cycle."""
        return self.predicted.frequency_hz / self.simulated.frequency_hz - 1.0 if self._both else None

    @property
    def _both(self) -> bool:
        return self.predicted.found and self.simulated.amplitude > 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Errors of predicted limit cycles: median and largest |relative error| of amplitude and frequency.

    `walls` is the number of walls with both a predicted and a simulated limit cycle.
    """

    walls: int
    amplitude: tuple[float, float]
    frequency: tuple[float, float]

    @classmethod
    def of(cls, walls: Sequence[HeldWall]) -> Errors:
        """Summarise the errors of walls that have a predicted and a simulated limit cycle; NaN without walls."""

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
    """Summary of how well theory predicts the limit cycles of all walls, with or without the rig's friction.

    Attributes
    ----------
    sinusoids, others
        Errors of the predicted amplitude and frequency: for walls whose motion is a sinusoid, and for all others.
    alone
        The same errors for walls where the loop without friction has a single predicted frequency.
    both_rest
        Number of walls that rest where no cycle is predicted or friction can hold the handle.
    only_predicted, only_simulated
        Number of walls that rest although a cycle is predicted, and number that oscillate although none is predicted.
    """

    friction: bool
    sinusoids: Errors
    others: Errors
    alone: Errors
    both_rest: int
    only_predicted: int
    only_simulated: int


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class LimitCycles(Shown):
    """Predicted and simulated limit cycles of all walls, without friction and with it."""

    rig: str
    walls: tuple[HeldWall, ...]

    @reported
    def tallies(self) -> tuple[Tally, ...]:
        """Two summaries of predicted and simulated limit cycles: of walls without friction, then with it."""
        return tuple(self.tally(friction) for friction in (False, True))

    def tally(self, friction: bool) -> Tally:
        """Return the summary of predicted and simulated limit cycles over the walls with or without friction."""
        walls = [wall for wall in self.walls if wall.friction is friction]
        both = [wall for wall in walls if wall.amplitude_error is not None]
        moving = [wall.simulated.amplitude > 0.0 for wall in walls]
        found = [wall.predicted.found for wall in walls]
        may_rest = [wall.predicted.may_rest or not wall.predicted.found for wall in walls]
        return Tally(
            friction=friction,
            sinusoids=Errors.of([wall for wall in both if wall.simulated.share >= PURE]),
            others=Errors.of([wall for wall in both if wall.simulated.share < PURE]),
            alone=Errors.of([wall for wall in both if wall.predicted.alone]),
            both_rest=sum(r and not m for m, r in zip(moving, may_rest, strict=True)),
            only_predicted=sum(not r and not m for m, r in zip(moving, may_rest, strict=True)),
            only_simulated=sum(m and not f for m, f in zip(moving, found, strict=True)),
        )

    def brief(self) -> list[Item]:
        """Return a heading and the errors of the prediction as text, without and with friction."""
        return [
            f"limit cycles of the quantum on {self.rig}, predicted and simulated",
            *map(_row, self.tallies),
        ]

    def detailed(self) -> list[Item]:
        """Return the errors of the prediction as text, and a table of all walls."""
        head = ("scheme", "B", "K", "friction", "counts", "Hz", "simulated: counts", "Hz", "in its band")
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
    def in_words(errors: Errors, what: str) -> str:
        (a, worst_a), (f, worst_f) = errors.amplitude, errors.frequency
        return (
            f"{errors.walls} {what}: amplitude {percent(a)} off (at most {percent(worst_a)}), "
            f"frequency {percent(f)} (at most {percent(worst_f)})"
        )

    parts = [in_words(tally.sinusoids, "sinusoids")] if tally.sinusoids.walls else []
    parts += [in_words(tally.others, "that are not sinusoidal")] if tally.others.walls else []
    parts += [in_words(tally.alone, "of these whose cycle is alone")] if tally.alone.walls else []
    parts += [f"{tally.both_rest} rest, as predicted (friction can hold them)"] if tally.both_rest else []
    parts += [f"{tally.only_predicted} rest although a cycle is predicted"] if tally.only_predicted else []
    parts += [f"{tally.only_simulated} cycle although none is predicted"] if tally.only_simulated else []
    return Row("with friction" if tally.friction else "without friction", "; ".join(parts))


def limit_cycles(
    experiment: Experiment, schemes: Sequence[Scheme] = (), walls: Sequence[tuple[float, float]] | None = None
) -> LimitCycles:
    """Predict and simulate the limit cycles of walls (K, B); None: fractions of K_max and B_max by linear theory.

    Without `schemes`, the experiment's sampling scheme and the uniform schemes at its rates are used. Raise
    `ConfigError` or `NotLinearError` if a scheme is not possible or not linear, `PlanError` for a wall without
    stiffness, in which the handle cannot rest.
    """
    for stiffness, damping in walls or ():
        if not (stiffness > 0.0 and damping >= 0.0):
            raise PlanError(
                f"the wall has K = {stiffness:g} and B = {damping:g}; K must be above zero, and B at "
                "least zero",
                remedy="choose a stiffness above zero and a damping of at least zero",
            )
    bare = replace(experiment, trial=replace(experiment.trial, kind="constant-effort"))
    chosen = tuple(schemes) or theory.default_schemes(bare)
    held: list[HeldWall] = []
    for scheme in chosen:
        loop = theory.linear_loop(bare, scheme)
        held += [
            _held(scheme.applied(bare), scheme.label(bare), loop, k, b, friction)
            for k, b in (_walls(loop) if walls is None else walls)
            for friction in (False, True)
        ]
    return LimitCycles(rig=experiment.rig.name, walls=tuple(held))


def _walls(loop: theory.LinearLoop) -> list[tuple[float, float]]:
    lifted = theory.Lifted.of(loop)
    dampings = [share * theory.damping_range(lifted) for share in DAMPINGS]
    limits = theory.k_max_curve(lifted, None, dampings)
    return [(share * limit.stiffness, limit.damping) for limit in limits for share in STIFFNESSES]


def _held(
    experiment: Experiment,
    label: str,
    loop: theory.LinearLoop,
    stiffness: float,
    damping: float,
    friction: bool,
) -> HeldWall:
    return HeldWall(
        scheme=label,
        damping=damping,
        stiffness=stiffness,
        friction=friction,
        predicted=theory.limit_cycle(loop, None, stiffness, damping, duty=DEPTH % 1.0, friction=friction),
        simulated=simulated(experiment, stiffness, damping, friction=friction),
    )


def simulated(experiment: Experiment, stiffness: float, damping: float, *, friction: bool) -> Cycle:
    """Simulate a handle that is released inside a wall, and measure its limit cycle after `SETTLE_S` seconds."""
    bare = without(experiment, (SATURATION,) if friction else (SATURATION, FRICTION))
    side, count = bare.wall.side, bare.rig.encoder.resolution
    wall = replace(experiment.wall, stiffness=stiffness, damping=damping, law="bilateral", position=0.0)
    trial = replace(experiment.trial, duration_s=SETTLE_S + MEASURED_S)
    start = Start(position=side * (DEPTH + AWAY) * count, external_effort=side * DEPTH * count * stiffness)
    _, plant, trace = simulate(replace(bare, wall=wall, trial=trial), start, OFFSET)
    last, rate = round(MEASURED_S * experiment.controller.position_rate), experiment.controller.position_rate
    return Cycle.of(trace.states[-last:, plant.sensed_position] / count, trace.counts[-last:], float(rate))
