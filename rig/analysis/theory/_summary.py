"""Collect the results of linear theory for a rig under several sampling schemes; `rig theory walls` prints them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.analysis.theory._lifted import Lifted
from rig.analysis.theory._limits import DampingLimit, Limit, b_max, k_max, k_max_curve
from rig.analysis.theory._linear import NotLinearError
from rig.analysis.theory._loop import LinearLoop, RigLike, SchemeLike, Subject, linear_loop, resolve
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
# The curve ends at this multiple of the largest damping at which any wall is stable.
CURVE_REACH = 1.1
# The curve has a point this share below B_max and one above it, because K_max falls to 0 there.
CLIFF = 1e-4
CORNER_POINTS, CORNER_REACH = 9, 1.5  # and some as far as passivity goes
PASSIVE_POINTS = 25  # of the passive walls, which end at a damping


@dataclass(frozen=True, slots=True)
class AtDamping:
    """Results of linear theory at one damping of a virtual wall: stability limit, and conditions for passivity."""

    limit: Limit
    passivity: PassivityBound

    @reported
    def binding(self) -> str:
        """Return the name of the proven passivity condition that allows the smallest stiffness."""
        return self.passivity.binding.name


@dataclass(frozen=True, slots=True)
class SchemeTheory:
    """Results of the theory for one sampling scheme.

    Attributes
    ----------
    scheme, label
        Text form of the scheme, and its name in a legend.
    delay_s
        Computation delay: whole ticks of this sampling scheme (s).
    at_zero, at_wall
        Results at B = 0 and at the requested damping of the wall.
    damping_limit, rigid_rule
        Exact B_max, and B_max by the approximate rule for a rigid rig (N·m·s/rad or N·s/m).
    curve
        Stability limits K_max at ascending dampings.
    passive
        Pairs of B and the largest K of a passive wall, with lag and delay, up to the largest passive B.
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
    """A sampling scheme that linear theory does not cover, and the reason."""

    scheme: str
    label: str
    reason: str


@dataclass(frozen=True, slots=True)
class InHand:
    """Stability limits of each sampling scheme at B = 0 while the experiment's modelled hand holds the handle."""

    operator: str
    limits: tuple[Limit, ...]


@dataclass(frozen=True, slots=True, repr=False)
class Theory(Shown, Drawn):
    """Results of the theory for a rig under several sampling schemes.

    Attributes
    ----------
    operator, end_mass
        Grip of the modelled hand, or ``none``, and the mass at the handle (kg), which is 0 with a hand.
    structure
        ``rigid``, for which the limit of passivity is exact, or ``two-mass``, for which it is sufficient.
    drive
        ``current`` or ``voltage``; under voltage drive the rig's damping includes back-EMF, behind the lag.
    lag_s, set_point_delay_s, delay_ticks
        Lag of the amplifier (s), delay of the set-point to it (s), and computation delay of the device (ticks).
    in_hand
        Limits with the experiment's hand; None if the caller chose the hand or if a person performs the trial.
    not_linear
        Schemes that are left out because they are not linear.
    cutoffs
        Note on cut-offs that differ between sampling schemes; None if they do not differ.
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
        """Return the lines of a short report: each sampling scheme's largest stable K at B = 0, and its stable B."""
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
    """Compute stability limits, passivity conditions and curves of a rig under several sampling schemes.

    Parameters
    ----------
    rig, operator
        Rig (preset name, path, experiment or model) and hand, as for `rig.analysis.theory._loop.resolve`.
    schemes
        Texts or `rig.config.schemes.Scheme`; `default_schemes` of the experiment if not given.
    damping
        Damping of the wall (N·m·s/rad or N·s/m) for `SchemeTheory.at_wall`; the experiment's if not given, 0 without an
        experiment.

    Raises
    ------
    ConfigError
        The rig, the hand or a sampling scheme is not valid. Schemes that are not linear are left out and listed in the
        result; if no scheme is linear, the error of the first scheme is raised.
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
    """Return linear loops with their schemes, and why the others are not linear; raise if no scheme is linear."""
    loops: list[tuple[Scheme, LinearLoop]] = []
    refused: list[NotLinear] = []
    first: NotLinearError | None = None
    for scheme in schemes:
        try:
            loop = linear_loop(subject, scheme)
            loop.estimator.check_counts_alone()
            loops.append((scheme, loop))
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
    """Return the experiment's sampling scheme and, if it is dual-rate, the uniform schemes at each of its two rates."""
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
    """Return dampings at which to compute limits: evenly spaced, next to B_max, and denser in the passive range."""
    reach = CURVE_REACH * max(largest.with_islands, damping)
    return np.unique(
        [
            *np.linspace(0.0, reach, CURVE_POINTS),
            largest.damping * (1.0 - CLIFF),
            largest.damping * (1.0 + CLIFF),
            *np.linspace(0.0, min(CORNER_REACH * passive, reach), CORNER_POINTS),
        ]
    )
