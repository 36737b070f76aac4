"""Criteria of a design, written down before any result: measures, goals, wishes, front, no worse, margin.

A scheme has seven measures (`Measures`). Four are of its walls, by simulated hits under the criterion *any* (stable,
and neither felt, heard nor moved), judged by what a rig records, means over encoder offsets: the largest K at B = 0,
the peak of K over B, the largest B at which a wall passes, and the area of the K–B plane below the boundary up to that
B. A damping that is not rendered (`rig.experiments.mapping._rendering`) counts as one at which no wall passes. Three
are of its velocity path alone (`rig.experiments.design._paths`).

**Best** is what has most of what the goal names: the peak (*stiffness*), the range of B (*damping*) or the area
(*area*). *Quiet* is the least noise among the schemes that have no less area than the experiment's own scheme. What
fulfils all wishes comes before what does not; of equals the one with less noise is the better.

**The front** holds each scheme for which no other is at least as good in peak, range of B, noise, fidelity and cost,
and better in one. All of it is of one round, so that all were measured by the same walls.

**No worse** (`Comparison`): the goal's measure (the area for *quiet*) of the recommended scheme against that
of the experiment's own, pair by pair, on offsets and seeds that the search did not see. It is no worse when the 95 %
interval (Student's t) of the mean difference lies above −`NEGLIGIBLE` of the own scheme's mean, and better when it lies
above zero. Where that is not shown, and the experiment's own scheme fulfils the wishes, too, that one is recommended.
A scheme without a single stable wall is never recommended: where no scheme has one, that is an error.

**As good as a paper's scheme** is one that reaches, to a rung of the search, the paper's scheme in K at B = 0, peak and
range of B, each (`OF_A_PAPER`). On the rig of Chawda et al. it also reaches it in the four rows of their Table I
(`OF_TABLE_ONE`): K-width to a rung, B-width to the column, the largest fidelity error (less is better) to `NEGLIGIBLE`,
all three of the impedances that all realisations together give, and no more numbers to tune. *None of the listed set
is as good* is stated only for the whole set (`rig.experiments.design._whole`): every scheme but the paper's own is
either measured whole, or missed a measure in a hit without which it cannot reach it.

**Margin** (`rig.experiments.design._margin`): at the damping of the wished wall, or else of the peak, the lowest limit
of K on rigs with all identified parameters drawn together from ±20 %, in every hand, over the limit on the described
rig. Every wall from the softest on has to pass. *What spoils it first* is the one parameter, moved by 20 % alone, or
the one hand, that leaves the lowest limit.
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
NEGLIGIBLE = 0.02  # of a measure
CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Measures:
    """Measures of a scheme on a rig.

    Attributes
    ----------
    undamped, stiffness
        Largest K at B = 0, and its peak over B (N·m/rad or N/m).
    damping
        Range of B (N·m·s/rad or N·s/m).
    area
        Area of the K–B plane below the boundary (product of their units).
    noise
        Rms of the velocity at rest (rad/s or m/s).
    fidelity_hz
        Up to where the rendered velocity is faithful.
    cost
        Cycles of the estimator per tick, the mean over a velocity period; None where no board runs it.
    """

    undamped: float
    stiffness: float
    damping: float
    area: float
    noise: float
    fidelity_hz: float
    cost: float | None

    def merit(self, objective: str) -> float:
        """Return a measure, so that more is better."""
        value: float | None = getattr(self, objective)
        return -math.inf if value is None else OBJECTIVES.get(objective, 1) * value


@dataclass(frozen=True, slots=True)
class BoundaryMeasures:
    """The measures of a boundary in the K–B plane: of a map, of a single series of it, or of theory."""

    undamped: float
    stiffness: float
    damping: float
    area: float

    @classmethod
    def of(cls, dampings: Sequence[float], limits: Sequence[float]) -> BoundaryMeasures:
        """Measure the largest K at each damping, which rise from 0."""
        extent = Extent.of(dampings, limits)
        return cls(undamped=limits[0], stiffness=max(limits), damping=extent.damping, area=extent.area)


def dominates(one: Measures, other: Measures) -> bool:
    """Return True if one is at least as good in every objective, and better in one."""
    pairs = [(one.merit(name), other.merit(name)) for name in OBJECTIVES]
    return all(a >= b for a, b in pairs) and any(a > b for a, b in pairs)


def front(found: Sequence[Measures]) -> list[int]:
    """Return which of these no other dominates, by index."""
    return [i for i, one in enumerate(found) if not any(dominates(other, one) for other in found)]


def as_good(one: Measures, other: Measures, step: float) -> bool:
    """Return True if one reaches another in each measure of a paper, to a rung of `step`."""
    return all(reaches(name, getattr(one, name), getattr(other, name), step) for name in OF_A_PAPER)


def reaches(name: str, one: float, other: float, step: float) -> bool:
    """Return True if one value of a paper's measure is as good as another; a missing one (NaN) is reached by all."""
    if math.isnan(other):
        return True
    if name == "tuned":
        return one <= other
    if name == "worst_fidelity":
        return one <= other * (1.0 + NEGLIGIBLE)
    return one * (1.0 if name == "b_width" else step) >= other


class UnmetError(PlanError):
    """No scheme of the listed set fulfils the wishes; says which of them binds, and by how much."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """Wishes for a design; limits of felt, heard and moved are the experiment's own.

    Attributes
    ----------
    goal
        Measure that decides among the schemes that fulfil the other wishes.
    wall
        K and B of a wall that has to be stable.
    fidelity_hz
        Up to where the rendered velocity has to be faithful.
    noise
        Largest rms velocity at rest.
    cost
        Most cycles per tick.
    """

    goal: Goal = "area"
    wall: tuple[float, float] | None = None
    fidelity_hz: float | None = None
    noise: float | None = None
    cost: float | None = None

    def __post_init__(self) -> None:
        """Raise `PlanError` for a wish that is no positive number."""
        named = {"fidelity_to": self.fidelity_hz, "most_noise": self.noise, "most_cost": self.cost}
        if self.wall is not None:
            named["must_be_stable"] = self.wall[0]
        check_positive(named)

    def of_path(self, noise: float, fidelity_hz: float, cost: float | None) -> dict[str, float]:
        """Return how far a velocity path fulfils each wish about it: from 1 on it does."""
        shares = {}
        if self.fidelity_hz is not None:
            shares["fidelity_hz"] = fidelity_hz / self.fidelity_hz
        if self.noise is not None:
            shares["noise"] = math.inf if noise == 0.0 else self.noise / noise
        if self.cost is not None:
            shares["cost"] = 0.0 if cost is None else (math.inf if cost == 0.0 else self.cost / cost)
        return shares

    def asked(self, name: str) -> str:
        """Return a wish in words; the argument that states it is named."""
        if name == "wall" and self.wall is not None:
            return f"K = {self.wall[0]:g} with B = {self.wall[1]:g} (`must_be_stable`)"
        option = {"fidelity_hz": "fidelity_to", "noise": "most_noise", "cost": "most_cost"}[name]
        return f"{getattr(self, name):g} (`{option}`)"


def measure_of(goal: Goal) -> str:
    """Return the measure of walls that a goal is compared by."""
    return "area" if goal == "quiet" else goal


def fulfilled(shares: Mapping[str, float]) -> bool:
    """Return True if every wish is fulfilled: no share is below 1."""
    return all(share >= 1.0 for share in shares.values())


def refuse_unmet(wishes: Wishes, shares: Sequence[Mapping[str, float]]) -> None:
    """Raise `UnmetError` if no scheme fulfils all wishes.

    The wish that binds is the one that comes least far among the schemes that fulfil all others; where none does, the
    one that comes least far at all.
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
    among = "of those that fulfil the other wishes" if beside and len(shares[0]) > 1 else "of them"
    raise UnmetError(
        f"none of {len(shares)} schemes fulfils the wishes: the limiting one is "
        f"{wishes.asked(binds)}; the best {among} reaches {reached[binds]:.2g} of it",
        remedy="relax this wish, allow higher rates (`most_rate`), or list other schemes (`scheme`)",
    )


def key(
    wishes: Wishes, measures: Measures, shares: Mapping[str, float], own_area: float
) -> tuple[float, ...]:
    """Return the sort key of a scheme, the best last: wishes first, then the goal; see the module's text."""
    met = min([1.0, *shares.values()])
    if wishes.goal == "quiet":
        enough = min(1.0, measures.area * (1.0 + NEGLIGIBLE) / own_area) if own_area > 0.0 else 1.0
        return (met, enough, -measures.noise)
    return (met, measures.merit(wishes.goal), -measures.noise)


@dataclass(frozen=True, slots=True)
class Comparison:
    """The goal's measure of the recommended and of the experiment's own scheme, pair by pair of offset and seed."""

    recommended: tuple[float, ...]
    own: tuple[float, ...]

    @property
    def interval(self) -> tuple[float, float, float]:
        """Return the mean difference over the own scheme's mean, and the ends of its interval of `CONFIDENCE`."""
        own = float(np.mean(self.own))
        differences = (np.array(self.recommended) - np.array(self.own)) / (own if own > 0.0 else 1.0)
        mean, n = float(differences.mean()), len(differences)
        if n < 2:
            return mean, -math.inf, math.inf
        half = float(special.stdtrit(n - 1, 0.5 + CONFIDENCE / 2.0) * differences.std(ddof=1) / math.sqrt(n))
        return mean, mean - half, mean + half

    @property
    def no_worse(self) -> bool:
        """Return True if the recommended scheme is shown to be no worse than the experiment's own."""
        return self.interval[1] >= -NEGLIGIBLE

    @property
    def better(self) -> bool:
        """Return True if the recommended scheme is shown to be better than the experiment's own."""
        return self.interval[1] > 0.0
