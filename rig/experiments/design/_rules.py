"""Criteria of a design, written down before any result: measures, goals, wishes, front, no worse, margin.

A sampling scheme has seven measures (`Measures`). Four describe its walls, by simulated hits under the criterion *any*
(stable, and neither felt, heard nor moved), judged by recorded signals, as means over encoder offsets: the largest K at
B = 0, the peak of K over B, the largest B at which a wall passes, and the area of the K–B plane below the boundary up
to that B. A damping that is not rendered (`rig.experiments.mapping._rendering`) counts as one at which no wall passes.
Three measures describe its velocity path (`rig.experiments.design._paths`): noise, fidelity and cost.

**Best** is the scheme with the largest value of the goal: the peak (*stiffness*), the range of B (*damping*) or the
area (*area*). With the goal *quiet* it is the scheme with the least noise among those whose area is not smaller than
that of the experiment's own scheme. A scheme that fulfils all wishes precedes one that does not; of equal schemes the
one with less noise is better.

**The front** contains each scheme for which no other scheme is at least as good in peak, range of B, noise, fidelity
and cost, and better in one of them. All its schemes are from one round, so that they were tested at the same walls.

**No worse** (`Comparison`): the goal's measure (the area for *quiet*) of the recommended scheme is compared with that
of the experiment's own scheme, in pairs, on encoder offsets and seeds that the search did not use. It is no worse if
the 95 % interval (Student's t) of the mean difference lies above −2 % of the own scheme's mean, and better if it lies
above zero. If it is not shown to be no worse, and the experiment's own scheme fulfils the wishes, too, the own scheme
is recommended. A scheme without a stable wall is never recommended; if no scheme has one, this is an error.

**As good as a paper's scheme** is a scheme whose K at B = 0, peak and range of B (`OF_A_PAPER`) each reach that of the
paper's scheme, to one step of the search. On the rig of Chawda et al. it must also reach the four rows of their Table I
(`OF_TABLE_ONE`): K-width to one step, B-width exactly, the largest fidelity error (less is better) to 2 %, all
three by the impedances of all realisations together; and it must not have more numbers to tune. *None of the listed
set is as good* is stated only for the whole set (`rig.experiments.design._whole`): each scheme except the paper's own
was either mapped completely, or failed a hit that is necessary to reach a measure.

**Margin** (`rig.experiments.design._margin`): at the damping of the wished wall, or else of the peak, the lowest limit
of K on rigs with all identified parameters drawn together from ±20 %, in every hand, divided by the limit on the
described rig. Every wall from the softest on has to pass. *What spoils it first* is the single parameter, changed by
20 %, or the single hand, with which the lowest limit remains.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from rig.core.deferred import special
from rig.core.errors import PlanError
from rig.experiments.mapping._searches import Extent
from rig.experiments.trials.planned import check_positive

Goal = Literal["stiffness", "damping", "area", "quiet"]
GOALS: tuple[Goal, ...] = get_args(Goal)
OBJECTIVES: Mapping[str, int] = {"stiffness": 1, "damping": 1, "noise": -1, "fidelity_hz": 1, "cost": -1}
OF_A_PAPER = ("undamped", "stiffness", "damping")
OF_TABLE_ONE = ("k_width", "b_width", "worst_fidelity", "tuned")
# A difference below this fraction of a measure is negligible.
NEGLIGIBLE = 0.02
CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Measures:
    """Measures by which sampling schemes on one rig are compared.

    Attributes
    ----------
    undamped, stiffness
        Largest K at B = 0, and largest K at any B (N·m/rad or N/m).
    damping
        Largest B at which a wall passes (N·m·s/rad or N·s/m).
    area
        Area of the K–B plane below the boundary (product of the units of K and B).
    noise
        Rms of the estimated velocity at rest (rad/s or m/s).
    fidelity_hz
        Frequency up to which the rendered velocity is faithful (Hz).
    cost
        Processor cycles of the estimator per tick, mean over a velocity period; None if the board cannot run the
        estimator.
    """

    undamped: float
    stiffness: float
    damping: float
    area: float
    noise: float
    fidelity_hz: float
    cost: float | None

    def merit(self, objective: str) -> float:
        """Return the value of the measure named `objective`, negated if less is better; −inf if it is missing."""
        value: float | None = getattr(self, objective)
        return -math.inf if value is None else OBJECTIVES.get(objective, 1) * value


@dataclass(frozen=True, slots=True)
class BoundaryMeasures:
    """Measures of the boundary of stable walls in the K–B plane: K at B = 0, peak K, largest B, and area below."""

    undamped: float
    stiffness: float
    damping: float
    area: float

    @classmethod
    def of(cls, dampings: Sequence[float], limits: Sequence[float]) -> BoundaryMeasures:
        """Return the measures of a boundary from its limits of K (SI units) at ascending dampings from 0."""
        extent = Extent.of(dampings, limits)
        return cls(undamped=limits[0], stiffness=max(limits), damping=extent.damping, area=extent.area)


def dominates(one: Measures, other: Measures) -> bool:
    """Return True if `one` is at least as good as `other` in each objective (like noise), and better in one or more."""
    pairs = [(one.merit(name), other.merit(name)) for name in OBJECTIVES]
    return all(a >= b for a, b in pairs) and any(a > b for a, b in pairs)


def front(found: Sequence[Measures]) -> list[int]:
    """Return the indices of the Pareto front: sampling schemes (given by their measures) that no other dominates."""
    return [i for i, one in enumerate(found) if not any(dominates(other, one) for other in found)]


def as_good(one: Measures, other: Measures, step: float) -> bool:
    """Return True if `one` is as good as `other` in K at B = 0, peak and range, to one `step` (ratio) of stiffness."""
    return all(reaches(name, getattr(one, name), getattr(other, name), step) for name in OF_A_PAPER)


def reaches(name: str, one: float, other: float, step: float) -> bool:
    """Return True if value `one` of the measure `name` is as good as value `other`, or if `other` is missing (NaN).

    `step` (above 1) is the ratio of neighbouring tested stiffnesses: a stiffness may be smaller by one step. "b_width"
    and "tuned" (number of tuned values) have no tolerance, "worst_fidelity" has 2 %.
    """
    if math.isnan(other):
        return True
    if name == "tuned":
        return one <= other
    if name == "worst_fidelity":
        return one <= other * (1.0 + NEGLIGIBLE)
    return one * (1.0 if name == "b_width" else step) >= other


class UnmetError(PlanError):
    """No listed sampling scheme meets all requirements; the message has the limiting one and its best result."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """Requirements on a sampling scheme; the limits of ripple are those of the experiment's verdict.

    Attributes
    ----------
    goal
        Measure by which sampling schemes that meet the other requirements are ranked.
    wall
        K and B of a wall that must be stable (N·m/rad and N·m·s/rad, or N/m and N·s/m).
    fidelity_hz
        Lowest allowed frequency up to which the rendered velocity is faithful (Hz).
    noise
        Highest allowed rms velocity at rest (rad/s or m/s).
    cost
        Highest allowed number of processor cycles per tick.
    """

    goal: Goal = "area"
    wall: tuple[float, float] | None = None
    fidelity_hz: float | None = None
    noise: float | None = None
    cost: float | None = None

    def __post_init__(self) -> None:
        """Raise `PlanError` for a requirement that is not a positive number."""
        named = {"fidelity_to": self.fidelity_hz, "most_noise": self.noise, "most_cost": self.cost}
        if self.wall is not None:
            named["must_be_stable"] = self.wall[0]
        check_positive(named)

    def of_path(self, noise: float, fidelity_hz: float, cost: float | None) -> dict[str, float]:
        """Return by name how far noise, fidelity and cost meet each requirement: a fraction, 1 or more if met."""
        shares = {}
        if self.fidelity_hz is not None:
            shares["fidelity_hz"] = fidelity_hz / self.fidelity_hz
        if self.noise is not None:
            shares["noise"] = math.inf if noise == 0.0 else self.noise / noise
        if self.cost is not None:
            shares["cost"] = 0.0 if cost is None else (math.inf if cost == 0.0 else self.cost / cost)
        return shares

    def asked(self, name: str) -> str:
        """Return the requirement `name` as a text with its value and the argument that set it."""
        if name == "wall" and self.wall is not None:
            return f"K = {self.wall[0]:g} with B = {self.wall[1]:g} (`must_be_stable`)"
        option = {"fidelity_hz": "fidelity_to", "noise": "most_noise", "cost": "most_cost"}[name]
        return f"{getattr(self, name):g} (`{option}`)"


def measure_of(goal: Goal) -> str:
    """Return the name of the measure by which schemes are compared for a goal: the goal itself, or area for "quiet"."""
    return "area" if goal == "quiet" else goal


def fulfilled(shares: Mapping[str, float]) -> bool:
    """Return True if every requirement is met; `shares` are the reached fractions by requirement, 1 or more if met."""
    return all(share >= 1.0 for share in shares.values())


def refuse_unmet(wishes: Wishes, shares: Sequence[Mapping[str, float]]) -> None:
    """Raise `UnmetError` if no sampling scheme meets all requirements; `shares` has their reached fractions per scheme.

    The error names the limiting requirement: the one that even the best scheme reaches least, among the schemes that
    meet all others, or among all schemes if none does.
    """
    if not shares or any(fulfilled(one) for one in shares):
        return
    alone, beside = {}, {}
    for name in shares[0]:
        alone[name] = max(one[name] for one in shares)
        others = [one for one in shares if fulfilled({key: one[key] for key in one if key != name})]
        if others:
            beside[name] = max(one[name] for one in others)
    reached = beside or alone
    binds = min(reached, key=lambda name: reached[name])
    among = "among those that meet the others" if beside and len(shares[0]) > 1 else "of all"
    raise UnmetError(
        f"none of {len(shares)} schemes meets all requirements: the limiting one is {wishes.asked(binds)}; the best "
        f"scheme {among} reaches {reached[binds]:.2g} of it",
        remedy="relax this requirement, allow higher rates (`most_rate`), or list other schemes (`scheme`)",
    )


def key(
    wishes: Wishes, measures: Measures, shares: Mapping[str, float], own_area: float
) -> tuple[float, ...]:
    """Return a sort key for schemes, the best last: first by met requirements, then by goal, then by less noise.

    `own_area` is the area of the experiment's own scheme, which a sampling scheme must reach if the goal is "quiet".
    """
    met = min([1.0, *shares.values()])
    if wishes.goal == "quiet":
        enough = min(1.0, measures.area * (1.0 + NEGLIGIBLE) / own_area) if own_area > 0.0 else 1.0
        return (met, enough, -measures.noise)
    return (met, measures.merit(wishes.goal), -measures.noise)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Paired values of the measure to maximise, for the recommended scheme and for the experiment's own scheme.

    `recommended` and `own` have one value for each encoder offset and seed.
    """

    recommended: tuple[float, ...]
    own: tuple[float, ...]

    @property
    def interval(self) -> tuple[float, float, float]:
        """Return the mean gain over the own scheme (fraction of its mean), and both ends of its 95 % interval."""
        own = float(np.mean(self.own))
        differences = (np.array(self.recommended) - np.array(self.own)) / (own if own > 0.0 else 1.0)
        mean, n = float(differences.mean()), len(differences)
        if n < 2:
            return mean, -math.inf, math.inf
        half = float(special.stdtrit(n - 1, 0.5 + CONFIDENCE / 2.0) * differences.std(ddof=1) / math.sqrt(n))
        return mean, mean - half, mean + half

    @property
    def no_worse(self) -> bool:
        """Return True if the recommended scheme is at most 2 % worse than the experiment's own (95 % interval)."""
        return self.interval[1] >= -NEGLIGIBLE

    @property
    def better(self) -> bool:
        """Return True if the 95 % interval of the gain over the experiment's own sampling scheme is above zero."""
        return self.interval[1] > 0.0
