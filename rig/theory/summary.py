"""Everything that theory says of a rig under some schemes, as one typed result: what `rig theory` prints and draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.config import Experiment
from rig.model import Operator
from rig.sample import Motion
from rig.schemes import Scheme
from rig.theory.lifted import Lifted
from rig.theory.limits import DampingLimit, Limit, b_max, k_max_curve
from rig.theory.loop import RigLike, SchemeLike, linear_loop, resolve
from rig.theory.passivity import PassivityBound, passivity_bound, rigid_b_max

Floats = NDArray[np.float64]

CURVE_POINTS = 41
CURVE_REACH = 1.1  # of the largest damping at which anything is stable
CLIFF = 1e-4  # a point of the curve so shortly before B_max, and one after it
CORNER_POINTS, CORNER_REACH = 9, 1.5  # and some as far as passivity goes


@dataclass(frozen=True, slots=True)
class AtDamping:
    """What holds at one damping: the exact limit of the linear loop, and the conditions for passivity."""

    limit: Limit
    passivity: PassivityBound

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {**asdict(self), "binding": self.passivity.binding.name}


@dataclass(frozen=True, slots=True)
class SchemeTheory:
    """Theory of one scheme.

    Attributes
    ----------
    scheme, label
        Its text, and what a legend calls it.
    at_zero, at_wall
        At B = 0 and at the experiment's damping.
    damping_limit, rigid_rule
        B_max, exact, and by the rule for a rigid rig.
    curve
        K_max over B.
    """

    scheme: str
    label: str
    at_zero: AtDamping
    at_wall: AtDamping
    damping_limit: DampingLimit
    rigid_rule: float
    curve: tuple[Limit, ...]

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            **asdict(self),
            "at_zero": self.at_zero.as_mapping(),
            "at_wall": self.at_wall.as_mapping(),
        }


@dataclass(frozen=True, slots=True)
class Theory:
    """Theory of a rig; `operator` names the hand on it, or says none."""

    rig: str
    motion: Motion
    operator: str
    damping: float
    rig_damping: float
    lag_s: float
    delay_s: float
    schemes: tuple[SchemeTheory, ...]

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {**asdict(self), "schemes": [scheme.as_mapping() for scheme in self.schemes]}


def theory_of(
    rig: RigLike,
    schemes: Sequence[SchemeLike] | None = None,
    *,
    operator: str | Operator | None = None,
    damping: float | None = None,
) -> Theory:
    """Limits, bounds and curves of a rig under schemes.

    Parameters
    ----------
    rig, operator
        See `rig.theory.loop.resolve`.
    schemes
        Texts or `rig.schemes.Scheme`; `default_schemes` of the experiment if not given.
    damping
        Of the wall, beside B = 0; the experiment's if not given, 0 without an experiment.

    Raises
    ------
    ConfigError
        As `rig.theory.loop.linear_loop`: above all an estimator that is not linear.
    """
    subject = resolve(rig, operator)
    experiment = subject.experiment
    if schemes is None:
        schemes = [] if experiment is None else default_schemes(experiment)
    if damping is None:
        damping = 0.0 if experiment is None else experiment.wall.damping
    asked = [Scheme.parse(scheme) if isinstance(scheme, str) else scheme for scheme in schemes]
    hand = subject.operator
    late = subject.model.amplifier.lag_s
    loops = [linear_loop(subject, scheme) for scheme in asked]
    return Theory(
        rig=subject.model.name,
        motion=subject.model.motion,
        operator="none" if hand is None else hand.grip,
        damping=damping,
        rig_damping=subject.damping,
        lag_s=late,
        delay_s=max((loop.late_s - late for loop in loops), default=0.0),
        schemes=tuple(
            _of_scheme(Lifted.of(loop), scheme, experiment, damping)
            for loop, scheme in zip(loops, asked, strict=True)
        ),
    )


def default_schemes(experiment: Experiment) -> tuple[Scheme, ...]:
    """Return the experiment's scheme and, if it is dual-rate, the two uniform ones that it lies between."""
    own = Scheme.of(experiment)
    if own.kind == "uniform":
        return (own,)
    rates = (own.position_rate, own.velocity_rate)
    return (own, *(Scheme(position_rate=rate, velocity_rate=rate) for rate in rates))


def _of_scheme(lifted: Lifted, scheme: Scheme, experiment: Experiment | None, damping: float) -> SchemeTheory:
    largest = b_max(lifted)
    curve = k_max_curve(lifted, None, [*_dampings(lifted, largest, damping), damping])
    return SchemeTheory(
        scheme=scheme.text,
        label=scheme.text if experiment is None else scheme.label(experiment),
        at_zero=AtDamping(curve[0], passivity_bound(lifted)),
        at_wall=AtDamping(curve[-1], passivity_bound(lifted, damping=damping)),
        damping_limit=largest,
        rigid_rule=rigid_b_max(lifted.loop),
        curve=curve[:-1],
    )


def _dampings(lifted: Lifted, largest: DampingLimit, damping: float) -> Floats:
    """Where the curve is computed: evenly, on both sides of the cliff, and where passivity is possible."""
    reach = CURVE_REACH * max(largest.with_islands, damping)
    corner = CORNER_REACH * passivity_bound(lifted).largest_damping
    return np.unique(
        [
            *np.linspace(0.0, reach, CURVE_POINTS),
            largest.damping * (1.0 - CLIFF),
            largest.damping * (1.0 + CLIFF),
            *np.linspace(0.0, min(corner, reach), CORNER_POINTS),
        ]
    )
