"""Estimate K_max, the stiffest stable wall, by condition and damping: of each participant, and over participants.

`analyse` calls it; `mixed` uses its intervals and counts. By the definition "rule", K_max is the mean over repeats of
the limits by the search rule; K50 is estimated from all verdicts together. A limit beyond the searched stiffnesses
(levels) is *censored*: it is replaced by the nearest level and counted, so a mean that contains censored limits is a
bound. ``rig/session/README.md`` states how often these intervals contain the true value.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import stats
from rig.extras.study.rows import MEASURES, LimitInterval, Measure, Observed, RunRow
from rig.session.search import FLOATING, is_resolved, unresolved_words

Floats = NDArray[np.float64]

LEAST_VALUES = (
    3  # participants or repeats for an interval: two give almost no information about their scatter
)
RESAMPLES = 9999

ENOUGH_REPEATS = 10  # for a bootstrap
MOSTLY_CENSORED = "most limits lie beyond the searched levels, so the mean is only a bound and is not tested"

IntervalOf = Literal["Student", "bootstrap", "run", "verdicts", "none"]
Bound = Literal["", "least", "most", "unknown"]
Cell = tuple[str, float]  # condition, damping


@dataclass(frozen=True, slots=True)
class Beyond:
    """Number of stiffness limits, and how many are above or below all searched stiffnesses, or marked as doubtful."""

    limits: int = 0
    above: int = 0
    below: int = 0
    marked: int = 0

    def __add__(self, other: Beyond) -> Beyond:
        return Beyond(
            self.limits + other.limits,
            self.above + other.above,
            self.below + other.below,
            self.marked + other.marked,
        )

    @property
    def count(self) -> int:
        """Number of censored limits: above or below all searched stiffnesses."""
        return self.above + self.below

    @property
    def mostly(self) -> bool:
        """True if more than half of the limits are censored: above or below all searched stiffnesses."""
        # Then a mean is little more than the end of the levels, and scatters as little: no interval, and no difference
        # with it has an interval or p.
        return 2 * self.count > self.limits


NONE_BEYOND = Beyond()


@dataclass(frozen=True, slots=True, kw_only=True)
class OfParticipant:
    """K_max (stiffest stable wall) of one participant under one condition at one damping.

    Attributes
    ----------
    repeats
        Number of complete searches that give a limit by this definition.
    mean, deviation
        Mean and standard deviation over repeats; for K50 the median of the posterior, and NaN.
    low, high, interval
        95 % interval and its source: "Student" or "bootstrap" over repeats, the single "run", all "verdicts", or "none"
        (NaN). The interval from all verdicts is of the stiffness that they show, and need not contain the mean of the
        rule's limits. Beyond the searched stiffnesses it is open: from zero, or to infinity.
    student_low, student_high, bootstrap_low, bootstrap_high
        Both intervals over repeats; NaN for K50, fewer than three repeats, equal repeats, or if most are censored.
    limits, above, below
        Number of limits, and number of limits above or below all searched stiffnesses.
    rounding
        Standard deviation of the error of `mean` that rounding to the searched stiffnesses makes.
    marked
        Number of doubtful limits, which the verdicts do not support; 0 unless `include_marked`.
    """

    measure: Measure
    participant: str
    condition: str
    damping: float
    repeats: int
    mean: float
    deviation: float
    low: float
    high: float
    interval: IntervalOf
    student_low: float
    student_high: float
    bootstrap_low: float
    bootstrap_high: float
    limits: int
    above: int
    below: int
    rounding: float = 0.0
    marked: int = 0

    @property
    def beyond(self) -> Beyond:
        """Numbers of all, of censored and of doubtful (marked) stiffness limits."""
        return Beyond(self.limits, self.above, self.below, self.marked)


@dataclass(frozen=True, slots=True, kw_only=True)
class OverParticipants:
    """K_max (stiffest stable wall) of a condition at one damping: mean of the participants' means over repeats.

    `low` and `high` are Student's 95 % interval over participants; NaN if `problem` gives a reason. `above` and `below`
    are the numbers of the `limits` that lie beyond the searched stiffnesses.
    """

    measure: Measure
    condition: str
    damping: float
    participants: int
    runs: int
    mean: float
    deviation: float
    low: float
    high: float
    limits: int
    above: int
    below: int
    problem: str = ""
    marked: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Paired:
    """Difference of K_max (stiffest stable wall) of two conditions within participants, by Student's paired test.

    With `damping` None it is the difference of the means over the dampings that both conditions have. `holm` is p after
    Holm's correction for all differences by the same definition of the limit. `beyond` counts the limits used, and
    those censored. Censored limits make the difference a bound: `bound` is "least", "most", or "unknown" if they do
    both. Interval and p are NaN if `problem` is not empty; `withheld` is True if most limits of a condition and damping
    are censored.
    """

    measure: Measure
    condition: str
    against: str
    damping: float | None
    participants: int
    difference: float
    low: float
    high: float
    p: float
    holm: float
    bound: Bound
    beyond: Beyond
    withheld: bool
    problem: str = ""


Pooled = Mapping[tuple[Measure, str, Cell], LimitInterval]  # by measure, participant and cell


def beyond_of(limits: Iterable[tuple[str, float, LimitInterval]]) -> dict[Cell, Beyond]:
    """Count all, censored and doubtful (marked) stiffness limits by (condition, damping)."""
    found: dict[Cell, Beyond] = {}
    for condition, damping, limit in limits:
        counts = Beyond(1, limit.censored == "above", limit.censored == "below", limit.mark != "")
        found[condition, damping] = found.get((condition, damping), NONE_BEYOND) + counts
    return found


def bound_of(beyond: Mapping[Cell, Beyond], condition: str, against: str) -> Bound:
    """Return how censored limits bound the difference of K_max under `condition` minus that under `against`.

    The result is "least" (lower bound), "most" (upper bound), "unknown" (both), or "" without censored limits.
    """
    sides = {
        name: sum((counts for (other, _), counts in beyond.items() if other == name), NONE_BEYOND)
        for name in (condition, against)
    }
    more = sides[condition].above > 0 or sides[against].below > 0
    less = sides[condition].below > 0 or sides[against].above > 0
    return "unknown" if more and less else "least" if more else "most" if less else ""


def collect_limits(runs: Sequence[RunRow], measure: Measure, pooled: Pooled) -> tuple[Observed, ...]:
    """Return the stiffness limits of complete searches, by the definition `measure`.

    `pooled` has the limits from all verdicts of a participant under a condition at a damping, which K50 uses.
    """
    # K50 is estimated from all verdicts together, so a run that alone does not determine K50 contributes its verdicts.
    counted = [
        run for run in runs if run.state == "complete" and (measure != "rule" or measure in run.limits)
    ]
    if measure == "rule":
        return tuple(_collect_limit(measure, [run], run.limits[measure]) for run in counted)
    groups: dict[tuple[str, Cell], list[RunRow]] = {}
    for run in counted:
        groups.setdefault((run.participant, (run.condition, run.damping)), []).append(run)
    return tuple(
        _collect_limit(measure, group, pooled[measure, code, cell])
        for (code, cell), group in groups.items()
        if (measure, code, cell) in pooled
    )


def _collect_limit(measure: Measure, runs: Sequence[RunRow], limit: LimitInterval) -> Observed:
    return Observed(
        measure=measure,
        participant=runs[0].participant,
        condition=runs[0].condition,
        damping=runs[0].damping,
        order=sum(run.order for run in runs) / len(runs),
        block=sum(run.block for run in runs) / len(runs),
        runs=len(runs),
        limit=limit,
    )


def estimate_participants(runs: Sequence[RunRow], pooled: Pooled, seed: int = 0) -> tuple[OfParticipant, ...]:
    """Estimate each participant's K_max (stiffest stable wall), by definition of the limit, condition and damping.

    `pooled` has the limits from all verdicts of a participant under a condition at a damping; `seed` is for the
    bootstrap.
    """
    found = []
    for measure in MEASURES:
        groups: dict[tuple[str, Cell], list[Observed]] = {}
        for observed in collect_limits(runs, measure, pooled):
            key = observed.participant, (observed.condition, observed.damping)
            groups.setdefault(key, []).append(observed)
        for (code, cell), group in groups.items():
            condition, damping = cell
            limits = [observed.limit for observed in group]
            values = np.array([limit.value for limit in limits])
            beyond = next(iter(beyond_of((*cell, limit) for limit in limits).values()))
            by_student, by_bootstrap = (math.nan, math.nan), (math.nan, math.nan)
            rounding = rounding_of([limit.rounding for limit in limits])
            if not beyond.mostly:
                tested = student(values, rounding, of="repeats")
                by_student = tested.low, tested.high
                by_bootstrap = (math.nan, math.nan) if tested.problem else bootstrap(values, seed)
            low, high, interval = _interval(
                limits, pooled.get((measure, code, cell)), by_student, by_bootstrap
            )
            found.append(
                OfParticipant(
                    measure=measure,
                    participant=code,
                    condition=condition,
                    damping=damping,
                    repeats=sum(observed.runs for observed in group),
                    mean=float(values.mean()),
                    deviation=_deviation(values),
                    low=low,
                    high=high,
                    interval=interval if measure == "rule" else "verdicts",
                    student_low=by_student[0],
                    student_high=by_student[1],
                    bootstrap_low=by_bootstrap[0],
                    bootstrap_high=by_bootstrap[1],
                    limits=beyond.limits,
                    above=beyond.above,
                    below=beyond.below,
                    rounding=rounding / math.sqrt(len(limits)),
                    marked=beyond.marked,
                )
            )
    return tuple(found)


def over_participants(
    each: Sequence[OfParticipant], conditions: Sequence[str]
) -> tuple[OverParticipants, ...]:
    """Average K_max (stiffest stable wall) over participants, by definition of the limit, condition and damping."""
    groups: dict[tuple[Measure, str, float], list[OfParticipant]] = {}
    for one in each:
        groups.setdefault((one.measure, one.condition, one.damping), []).append(one)
    found = []

    def in_order(key: tuple[Measure, str, float]) -> tuple[int, int, float]:
        measure, condition, damping = key
        return MEASURES.index(measure), conditions.index(condition), damping

    for measure, condition, damping in sorted(groups, key=in_order):
        group = groups[measure, condition, damping]
        values = np.array([one.mean for one in group])
        beyond = sum((one.beyond for one in group), NONE_BEYOND)
        interval = (
            Student(problem=MOSTLY_CENSORED)
            if beyond.mostly
            else student(values, rounding_of([one.rounding for one in group]))
        )
        found.append(
            OverParticipants(
                measure=measure,
                condition=condition,
                damping=damping,
                participants=len(group),
                runs=sum(one.repeats for one in group),
                mean=float(values.mean()),
                deviation=_deviation(values),
                low=interval.low,
                high=interval.high,
                limits=beyond.limits,
                above=beyond.above,
                below=beyond.below,
                problem=interval.problem,
                marked=beyond.marked,
            )
        )
    return tuple(found)


def compare_pairs(each: Sequence[OfParticipant], conditions: Sequence[str]) -> tuple[Paired, ...]:
    """Return the differences of K_max (stiffest stable wall) of all pairs of conditions.

    There is one at each damping that both conditions have, and one over all these dampings.
    """
    return tuple(
        one for measure in MEASURES for one in _correct_holm(_compare_pairs(each, measure, conditions))
    )


def _correct_holm(family: Sequence[Paired]) -> list[Paired]:
    corrected = holm([one.p for one in family])
    return [replace(one, holm=p) for one, p in zip(family, corrected, strict=True)]


def _compare_pairs(
    each: Sequence[OfParticipant], measure: Measure, conditions: Sequence[str]
) -> list[Paired]:
    known = {(one.participant, one.condition, one.damping): one for one in each if one.measure == measure}
    beyond: dict[Cell, Beyond] = {}
    for one in known.values():
        cell = (one.condition, one.damping)
        beyond[cell] = beyond.get(cell, NONE_BEYOND) + one.beyond
    dampings: list[float | None] = [*sorted({one.damping for one in known.values()})]
    if len(dampings) > 1:
        dampings.append(None)
    found: list[Paired] = []
    for damping in dampings:
        for against, condition in combinations(conditions, 2):
            differences, rounding = _differences(known, against, condition, damping)
            if not len(differences):
                continue
            used = _find_used_cells(beyond, against, condition, damping)
            withheld = any(counts.mostly for counts in used.values())
            tested = (
                Student(problem=MOSTLY_CENSORED)
                if withheld
                else student(differences, rounding, of="participants", what="the differences")
            )
            found.append(
                Paired(
                    measure=measure,
                    condition=condition,
                    against=against,
                    damping=damping,
                    participants=len(differences),
                    difference=float(differences.mean()),
                    low=tested.low,
                    high=tested.high,
                    p=tested.p,
                    holm=math.nan,
                    bound=bound_of(used, condition, against),
                    beyond=sum(used.values(), NONE_BEYOND),
                    withheld=withheld,
                    problem=tested.problem,
                )
            )
    return found


def _find_used_cells(
    beyond: Mapping[Cell, Beyond], against: str, condition: str, damping: float | None
) -> dict[Cell, Beyond]:
    dampings = {
        name: {of_cell for other, of_cell in beyond if other == name} for name in (against, condition)
    }
    common = dampings[against] & dampings[condition]
    return {
        (name, of_cell): counts
        for (name, of_cell), counts in beyond.items()
        if name in (against, condition) and of_cell in common and damping in (None, of_cell)
    }


@dataclass(frozen=True, slots=True)
class Student:
    """Student's 95 % interval of a mean, and the two-sided p that the mean is zero; NaN if `problem` gives a reason."""

    low: float = math.nan
    high: float = math.nan
    p: float = math.nan
    problem: str = ""


def student(
    values: Floats, rounding: float = 0.0, *, of: str = "participants", what: str = "the values"
) -> Student:
    """Compute Student's interval and test of the mean of `values`, one for each participant or repeat.

    `problem` gives the reason if there are fewer than `LEAST_VALUES` values, or if their scatter is no larger than
    `rounding`, the standard deviation that rounding to the searched stiffnesses causes. `of` and `what` are words for
    the values in this reason.
    """
    if len(values) < LEAST_VALUES:
        return Student(problem=too_few_words(len(values), of))
    deviation = float(values.std(ddof=1))
    if not is_resolved(deviation, rounding, float(np.abs(values).max())):
        return Student(problem=unresolved_words(f"{what} of the {of}", deviation, rounding))
    tested = stats.ttest_1samp(values, 0.0)
    low, high = tested.confidence_interval(0.95)
    return Student(float(low), float(high), float(tested.pvalue))


def too_few_words(count: int, of: str) -> str:
    """Return the text that `count` participants or repeats (`of`) are too few for an interval."""
    noun = of.replace("participants", "participant").replace("repeats", "repeat") if count == 1 else of
    return f"{count} {noun}; an interval and a p value need {LEAST_VALUES} or more"


def rounding_of(roundings: Sequence[float]) -> float:
    """Return the root mean square of `roundings`, the standard deviations of single values by rounding."""
    return math.sqrt(sum(one**2 for one in roundings) / len(roundings))


def holm(p: Sequence[float]) -> list[float]:
    """Correct p values by Holm's method (Scandinavian Journal of Statistics 6, 1979); NaN stays NaN, not counted."""
    known = sorted((value, index) for index, value in enumerate(p) if math.isfinite(value))
    adjusted, largest = [math.nan] * len(p), 0.0
    for rank, (value, index) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * value))
        adjusted[index] = largest
    return adjusted


def bootstrap(values: Floats, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of a mean (BCa, else percentile); NaN if there are too few or equal values."""
    if student(values).problem:
        return math.nan, math.nan
    for method in ("BCa", "percentile"):
        with warnings.catch_warnings():
            # BCa warns and gives NaN for degenerate data; then the percentile method is used.
            warnings.simplefilter("ignore")
            drawn = np.random.default_rng(seed)
            found = stats.bootstrap(
                (values,), np.mean, n_resamples=RESAMPLES, method=method, random_state=drawn
            )
        low, high = found.confidence_interval
        if math.isfinite(low) and math.isfinite(high):
            break
    return float(low), float(high)


def _interval(
    limits: Sequence[LimitInterval],
    pooled: LimitInterval | None,
    by_student: tuple[float, float],
    by_bootstrap: tuple[float, float],
) -> tuple[float, float, IntervalOf]:
    if len(limits) >= ENOUGH_REPEATS and math.isfinite(by_bootstrap[0]):
        return (*by_bootstrap, "bootstrap")
    if len(limits) >= LEAST_VALUES and math.isfinite(by_student[0]):
        return (*by_student, "Student")
    if len(limits) == 1 and (limits[0].censored or math.isfinite(limits[0].high - limits[0].low)):
        return limits[0].low, limits[0].high, "run"
    if pooled is not None:
        return pooled.low, pooled.high, "verdicts"
    return math.nan, math.nan, "none"


def _differences(
    known: Mapping[tuple[str, str, float], OfParticipant],
    against: str,
    condition: str,
    damping: float | None,
) -> tuple[Floats, float]:
    """Return K_max under `condition` minus that under `against` for each participant who has both, at `damping`.

    With `damping` None it is the mean difference over all common dampings. The second value is the standard deviation
    of the differences that rounding to the searched stiffnesses causes.
    """
    participants = dict.fromkeys(code for code, _, _ in known)
    tested = {name: {at for _, other, at in known if other == name} for name in (against, condition)}
    dampings = [damping] if damping is not None else sorted(tested[against] & tested[condition])
    if damping is None and len(dampings) < 2:
        # With one common damping the difference is already listed at this damping.
        return np.array([]), 0.0
    values, variances = [], []
    for code in participants:
        pairs = [(known.get((code, condition, at)), known.get((code, against, at))) for at in dampings]
        both = [(one, other) for one, other in pairs if one is not None and other is not None]
        if both and len(both) == len(pairs):
            values.append(sum(_subtract(one.mean, other.mean) for one, other in both) / len(both))
            variances.append(sum(one.rounding**2 + other.rounding**2 for one, other in both) / len(both) ** 2)
    return np.array(values), math.sqrt(sum(variances) / len(variances)) if variances else 0.0


def _subtract(one: float, other: float) -> float:
    return 0.0 if math.isclose(one, other, rel_tol=FLOATING) else one - other


def _deviation(values: Floats) -> float:
    if len(values) < 2:
        return math.nan
    deviation = float(values.std(ddof=1))
    return deviation if is_resolved(deviation, magnitude=float(np.abs(values).max())) else 0.0
