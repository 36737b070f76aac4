"""All that theory says of a rig under some schemes, as one typed result: what `rig theory walls` prints and draws."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.analysis.theory._lifted import Lifted
from rig.analysis.theory._limits import DampingLimit, Limit, b_max, k_max, k_max_curve
from rig.analysis.theory._linear import NotLinearError
from rig.analysis.theory._loop import (
    LinearLoop,
    RigLike,
    SchemeLike,
    Subject,
    linear_loop,
    resolve,
)
from rig.analysis.theory._passivity import PassivityBound, passive_curve, passivity_bound, rigid_b_max
from rig.config import Experiment
from rig.config.schemes import Scheme, describe_cutoffs
from rig.core.model import Operator
from rig.core.operators import NO_OPERATOR
from rig.core.present import Item, Row, reported, written
from rig.core.sample import Motion, unit_of
from rig.core.shown import Drawn, Shown

Floats = NDArray[np.float64]

CURVE_POINTS = 41
CURVE_REACH = 1.1  # of the largest damping at which anything is stable
CLIFF = 1e-4  # a point of the curve so shortly before B_max, and one after it
CORNER_POINTS, CORNER_REACH = 9, 1.5  # and some as far as passivity goes
PASSIVE_POINTS = 25  # of the passive walls, which end at a damping


@dataclass(frozen=True, slots=True)
class AtDamping:
    """Results at one damping: the exact limit of the linear loop, and the conditions for passivity."""

    limit: Limit
    passivity: PassivityBound

    @reported
    def binding(self) -> str:
        """Name of the condition with the smallest stiffness, approximate rules aside."""
        return self.passivity.binding.name


@dataclass(frozen=True, slots=True)
class SchemeTheory:
    """Theory of one scheme.

    Attributes
    ----------
    scheme, label
        Its text, and what a legend calls it.
    delay_s
        Computation delay of the rig, in its ticks.
    at_zero, at_wall
        At B = 0 and at the experiment's damping.
    damping_limit, rigid_rule
        B_max, exact, and by the rule for a rigid rig.
    curve
        K_max over B.
    passive
        B and the largest K of a passive wall, lag and delay counted, to the end of the range.
    """

    scheme: str
    label: str
    delay_s: float
    at_zero: AtDamping
    at_wall: AtDamping
    damping_limit: DampingLimit
    rigid_rule: float
    curve: tuple[Limit, ...]
    passive: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class NotLinear:
    """A scheme that linear theory has nothing to say about, and why."""

    scheme: str
    label: str
    reason: str


@dataclass(frozen=True, slots=True)
class InHand:
    """Limits of the same schemes at B = 0, in the hand of the experiment."""

    operator: str
    limits: tuple[Limit, ...]


@dataclass(frozen=True, slots=True, repr=False)
class Theory(Shown, Drawn):
    """Theory of a rig.

    Attributes
    ----------
    operator, end_mass
        The hand on it, or ``none``, and then the mass at the handle (kg).
    structure
        ``rigid`` or ``two-mass``: of the former the limit of passivity is exact.
    drive
        ``current`` or ``voltage``: the latter's back-EMF is part of the rig's damping, behind the lag.
    lag_s, set_point_delay_s, delay_ticks
        Lag of the amplifier (s), delay of the set-point to it (s), and the far end's computation beside these (ticks).
    in_hand
        For a rig that is meant for an automated trial and was asked about as it is.
    not_linear
        Schemes that were left out.
    cutoffs
        How the cut-offs differ between schemes that state none; None where they do not.
    """

    rig: str
    motion: Motion
    structure: str
    operator: str
    end_mass: float
    damping: float
    rig_damping: float
    drive: str
    lag_s: float
    set_point_delay_s: float
    delay_ticks: int
    schemes: tuple[SchemeTheory, ...]
    in_hand: InHand | None = None
    not_linear: tuple[NotLinear, ...] = ()
    cutoffs: str | None = None

    def brief(self) -> list[Item]:
        """Return the largest stable stiffness without damping, and the largest damping, of each scheme."""
        stiffness, damping = (unit_of(name, self.motion) for name in ("stiffness", "damping"))
        rows = [
            Row(
                scheme.label,
                f"K up to {written(scheme.at_zero.limit.stiffness)} {stiffness} at B = 0, "
                f"B up to {written(scheme.damping_limit.damping)} {damping}",
            )
            for scheme in self.schemes
        ]
        refused = [Row(scheme.label, f"not linear: {scheme.reason}") for scheme in self.not_linear]
        notes = [] if self.cutoffs is None else [self.cutoffs]
        return [f"linear theory of {self.rig}, hand: {self.operator}", *rows, *refused, *notes]


def theory_of(
    rig: RigLike,
    schemes: Sequence[SchemeLike] | None = None,
    *,
    operator: str | Operator | None = None,
    damping: float | None = None,
) -> Theory:
    """Return the limits, bounds and curves of a rig under schemes.

    Parameters
    ----------
    rig, operator
        See `rig.analysis.theory._loop.resolve`.
    schemes
        Texts or `rig.config.schemes.Scheme`; `default_schemes` of the experiment if not given.
    damping
        Damping of the wall, beside B = 0; the experiment's if not given, 0 without an experiment.

    Raises
    ------
    ConfigError
        As `rig.analysis.theory._loop.linear_loop`; schemes that are not linear are left out and listed in the result,
        unless none is linear.
    """
    subject = resolve(rig, operator)
    experiment = subject.experiment
    if schemes is None:
        schemes = [] if experiment is None else default_schemes(experiment)
    if damping is None:
        damping = 0.0 if experiment is None else experiment.wall.damping
    asked = [Scheme.parse(scheme) if isinstance(scheme, str) else scheme for scheme in schemes]
    loops, not_linear = _linear(subject, asked)
    hand, mechanics = subject.operator, subject.model.mechanics
    return Theory(
        rig=subject.model.name,
        motion=subject.model.motion,
        structure=mechanics.structure,
        operator=NO_OPERATOR if hand is None else hand.grip,
        end_mass=mechanics.end_mass,
        damping=damping,
        rig_damping=subject.damping,
        drive=subject.model.amplifier.drive,
        lag_s=subject.model.amplifier.lag_s,
        set_point_delay_s=subject.model.amplifier.set_point_delay_s,
        delay_ticks=subject.model.simulation.computation_delay_ticks,
        schemes=tuple(_of_scheme(Lifted.of(loop), scheme, experiment, damping) for scheme, loop in loops),
        in_hand=_in_hand(subject, [scheme for scheme, _ in loops]) if operator is None else None,
        not_linear=not_linear,
        cutoffs=None if experiment is None else describe_cutoffs((scheme for scheme, _ in loops), experiment),
    )


def _linear(
    subject: Subject, schemes: Sequence[Scheme]
) -> tuple[list[tuple[Scheme, LinearLoop]], tuple[NotLinear, ...]]:
    """Return the loops of the linear schemes, and the errors of the others; raise the first if all are nonlinear."""
    loops: list[tuple[Scheme, LinearLoop]] = []
    refused: list[NotLinear] = []
    first: NotLinearError | None = None
    for scheme in schemes:
        try:
            loops.append((scheme, linear_loop(subject, scheme)))
        except NotLinearError as error:
            first = first or error
            refused.append(NotLinear(scheme.text, _label(scheme, subject.experiment), error.reason))
    if first is not None and not loops:
        raise first
    return loops, tuple(refused)


def _in_hand(subject: Subject, schemes: Sequence[Scheme]) -> InHand | None:
    experiment = subject.experiment
    if experiment is None or experiment.trial.kind == "human":
        return None
    held = resolve(experiment, experiment.operator)
    limits = tuple(k_max(Lifted.of(linear_loop(held, scheme))) for scheme in schemes)
    return InHand(experiment.operator.grip, limits)


def _label(scheme: Scheme, experiment: Experiment | None) -> str:
    return scheme.text if experiment is None else scheme.label(experiment)


def default_schemes(experiment: Experiment) -> tuple[Scheme, ...]:
    """Return the experiment's scheme and, if it is dual-rate, the two uniform ones that it lies between."""
    own = Scheme.of(experiment)
    if own.kind == "uniform":
        return (own,)
    rates = (own.position_rate, own.velocity_rate)
    return (own, *(Scheme(position_rate=rate, velocity_rate=rate) for rate in rates))


def _of_scheme(lifted: Lifted, scheme: Scheme, experiment: Experiment | None, damping: float) -> SchemeTheory:
    largest = b_max(lifted)
    undamped = passivity_bound(lifted)
    end = undamped.largest_damping if math.isfinite(undamped.largest_damping) else largest.damping
    curve = k_max_curve(lifted, None, [*_dampings(largest, end, damping), damping])
    passive = np.linspace(0.0, end, PASSIVE_POINTS).tolist()
    return SchemeTheory(
        scheme=scheme.text,
        label=_label(scheme, experiment),
        delay_s=lifted.loop.delay_ticks * lifted.loop.tick_s,
        at_zero=AtDamping(curve[0], undamped),
        at_wall=AtDamping(curve[-1], passivity_bound(lifted, damping=damping)),
        damping_limit=largest,
        rigid_rule=rigid_b_max(lifted.loop),
        curve=curve[:-1],
        passive=tuple(zip(passive, passive_curve(lifted, passive), strict=True)),
    )


def _dampings(largest: DampingLimit, passive: float, damping: float) -> Floats:
    """Return where the curve is computed: evenly, on both sides of the cliff, and where passivity is possible."""
    reach = CURVE_REACH * max(largest.with_islands, damping)
    return np.unique(
        [
            *np.linspace(0.0, reach, CURVE_POINTS),
            largest.damping * (1.0 - CLIFF),
            largest.damping * (1.0 + CLIFF),
            *np.linspace(0.0, min(CORNER_REACH * passive, reach), CORNER_POINTS),
        ]
    )
