"""Estimate order and fatigue: whether limits, verdicts and trials change during a session.

The slopes were not planned: they are exploratory, and the p values of the slopes of one quantity are corrected for
their number (Holm).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import stats
from rig.extras.study.kmax import LEAST_VALUES, beyond_of, holm, rounding_of, too_few_words
from rig.extras.study.rows import MEASURES, Measure, RunRow, TrialRow
from rig.session.finished import VOIDED
from rig.session.search import FLOATING, is_resolved, unresolved_words

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Slope:
    """Change of a quantity along the session: mean over participants of each participant's slope, with a 95 % interval.

    Attributes
    ----------
    of, measure
        Quantity: "limit" (stiffness, by the definition `measure`), "response time" (natural logarithm of s) or
        "invalid" (0 or 1).
    along
        Position in the session: "order" (place in the block), "block", or "trial" (number in the session).
    count, participants
        Number of values, and of participants who have a slope.
    slope, low, high, p, holm
        Change per place, block or trial, its interval and p; NaN if `problem` gives a reason. `holm` is p after Holm's
        correction for the slopes of one quantity; each definition of the limit is a quantity of its own.
    """

    of: str
    along: str
    measure: Measure | str
    count: int
    participants: int
    slope: float
    low: float
    high: float
    p: float
    holm: float = math.nan
    problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockRow:
    """Summary of the trials in one block of one participant.

    `trials` counts all recorded trials, also those that do not count; `invalid` the invalid ones, `redone` those
    repeated at the operator's request, `aborted` those cut off for safety; `unsure` counts the verdicts "unsure".
    `response_s` is the median time to a verdict (s); None without a verdict.
    """

    participant: str
    block: int
    trials: int
    invalid: int
    redone: int
    aborted: int
    unsure: int
    response_s: float | None


def slopes(runs: Sequence[RunRow], trials: Sequence[TrialRow]) -> tuple[Slope, ...]:
    """Compute the slopes of stiffness limits (by each definition), verdict times and invalid trials along a session."""
    found: list[Slope] = []
    positions: dict[str, Callable[[RunRow], float]] = {
        "order": lambda run: float(run.order),
        "block": lambda run: float(run.block),
        "trial": lambda run: run.middle_trial,
    }
    for measure in MEASURES:
        counted = [run for run in runs if run.state == "complete" and measure in run.limits]
        beyond = beyond_of((run.condition, run.damping, run.limits[measure]) for run in counted)
        # Mostly censored limits are the end of the levels, not of a person.
        counted = [run for run in counted if not beyond[run.condition, run.damping].mostly]
        limits = np.array([run.limits[measure].value for run in counted])
        cells = [(run.participant, run.condition, run.damping) for run in counted]
        family = []
        roundings = np.array([run.limits[measure].rounding for run in counted])
        for along, position in positions.items():
            at = np.array([position(run) for run in counted])
            slope = _estimate_slope("limit", along, measure, at, limits, cells, roundings)
            if beyond and not counted:
                slope = replace(slope, problem="most limits lie beyond the searched levels")
            family.append(slope)
        found += _correct_holm(family)
    kept = [trial for trial in trials if not trial.practice and trial.void not in VOIDED]
    timed = [
        trial
        for trial in kept
        if trial.judged_by in ("person", "simulated")
        and trial.response_time_s is not None
        and trial.response_time_s > 0.0
    ]
    log_times = [math.log(trial.response_time_s) for trial in timed if trial.response_time_s]
    invalid = [float(trial.void == "invalid") for trial in kept]
    for quantity, used, values in (("response time", timed, log_times), ("invalid", kept, invalid)):
        at = np.array([float(trial.trial) for trial in used])
        cells = [(trial.participant, trial.condition, trial.damping) for trial in used]
        found += _correct_holm([_estimate_slope(quantity, "trial", "", at, np.array(values), cells)])
    return tuple(found)


def _correct_holm(family: Sequence[Slope]) -> list[Slope]:
    return [replace(one, holm=p) for one, p in zip(family, holm([one.p for one in family]), strict=True)]


def blocks(trials: Sequence[TrialRow]) -> tuple[BlockRow, ...]:
    """Summarise the trials of each participant's blocks, practice excluded."""
    groups: dict[tuple[str, int], list[TrialRow]] = {}
    for trial in trials:
        if not trial.practice:
            groups.setdefault((trial.participant, trial.block), []).append(trial)
    return tuple(_block(code, block, group) for (code, block), group in groups.items())


def _block(code: str, block: int, trials: Sequence[TrialRow]) -> BlockRow:
    times = [
        trial.response_time_s
        for trial in trials
        if trial.judged_by in ("person", "simulated") and trial.response_time_s is not None
    ]
    return BlockRow(
        participant=code,
        block=block,
        trials=len(trials),
        invalid=sum(trial.void == "invalid" for trial in trials),
        redone=sum(trial.void == "redone" for trial in trials),
        aborted=sum(trial.aborted != "" for trial in trials),
        unsure=sum(trial.verdict == "unsure" for trial in trials),
        response_s=median(times) if times else None,
    )


def _estimate_slope(
    of: str,
    along: str,
    measure: Measure | str,
    at: Floats,
    values: Floats,
    cells: Sequence[tuple[str, str, float]],
    roundings: Floats | None = None,
) -> Slope:
    each = within_slopes(at, values, cells)
    rounding = 0.0 if roundings is None or not each else _rounding_of_slopes(at, roundings, cells, each)
    mean = _average_slopes(each, _is_shared(cells), rounding)
    return Slope(
        of=of,
        along=along,
        measure=measure,
        count=len(values),
        participants=len(each),
        slope=mean.slope,
        low=mean.low,
        high=mean.high,
        p=mean.p,
        problem=mean.problem,
    )


def within_slopes(at: Floats, values: Floats, cells: Sequence[tuple[str, str, float]]) -> dict[str, float]:
    """Return the slope of `values` along their places `at` in the session, by participant.

    `cells` are participant, condition and damping of each value. Participants with a single place are left out.
    """
    if not cells:
        return {}
    centred_at, centred_values = less_means(at, cells), less_means(values, cells)
    codes = np.array([code for code, _, _ in cells])
    found = {}
    for code in dict.fromkeys(codes.tolist()):
        own = codes == code
        square = float(centred_at[own] @ centred_at[own])
        if square > 0.0:
            found[code] = float(centred_at[own] @ centred_values[own]) / square
    return found


def _rounding_of_slopes(
    at: Floats, roundings: Floats, cells: Sequence[tuple[str, str, float]], each: Mapping[str, float]
) -> float:
    """Return the standard deviation of the slopes that follows from rounding limits to the searched stiffnesses."""
    centred_at, codes = less_means(at, cells), np.array([code for code, _, _ in cells])
    own_values = [(centred_at[codes == code], roundings[codes == code]) for code in each]
    return rounding_of([float(np.linalg.norm(at * rounding) / (at @ at)) for at, rounding in own_values])


@dataclass(frozen=True, slots=True)
class _MeanSlope:
    slope: float = math.nan
    low: float = math.nan
    high: float = math.nan
    p: float = math.nan
    problem: str = ""


def _average_slopes(each: Mapping[str, float], shared: bool, rounding: float) -> _MeanSlope:
    """Return mean, 95 % interval and p of the participants' slopes (Student), or the `problem` with them.

    If `shared`, the means of the conditions are estimated from the same values, which takes one more degree of freedom:
    with two conditions, each searched once, this is the two-sample test of a crossover.
    """
    # A slope for each person, and Student's interval over these: an interval over trials would take 150 trials of a
    # person for 150 people.
    slopes = np.array(list(each.values()))
    count = len(slopes)
    if count == 0:
        return _MeanSlope(problem="this effect cannot be separated from participants and conditions")
    if count < LEAST_VALUES:
        return _MeanSlope(problem=too_few_words(count, "participants with a slope of their own"))
    if not np.any(slopes):
        return _MeanSlope(problem="all values are equal within participants and conditions")
    mean, freedom = float(slopes.mean()), count - (2 if shared else 1)
    residuals = slopes - mean
    scatter = math.sqrt(float(residuals @ residuals) / freedom)
    if not is_resolved(scatter, rounding, float(np.abs(slopes).max())):
        return _MeanSlope(problem=unresolved_words("the slopes of the participants", scatter, rounding))
    deviation = scatter / math.sqrt(count)
    low, high = stats.t.interval(0.95, freedom, mean, deviation)
    p = float(2.0 * stats.t.sf(abs(mean) / deviation, freedom))
    return _MeanSlope(mean, float(low), float(high), p)


def _is_shared(cells: Sequence[tuple[str, str, float]]) -> bool:
    """Return True if no participant has two values of one condition and damping; means then need all participants."""
    return len(set(cells)) == len(cells)


def less_means(values: Floats, cells: Sequence[tuple[str, str, float]]) -> Floats:
    """Return `values` minus the means of participants and conditions; rounding errors of the result become zero."""
    if not cells:
        return values
    if _is_shared(cells):
        participants, conditions = [code for code, *_ in cells], [tuple(rest) for _, *rest in cells]
        fixed = np.column_stack([_indicators(participants), _indicators(conditions)])
        residuals = np.asarray(values - fixed @ np.linalg.lstsq(fixed, values, rcond=None)[0])
    else:
        numbers = {cell: number for number, cell in enumerate(dict.fromkeys(cells))}
        groups = np.array([numbers[cell] for cell in cells])
        residuals = np.asarray(values - (np.bincount(groups, values) / np.bincount(groups))[groups])
    residuals[np.abs(residuals) <= FLOATING * np.abs(values).max()] = 0.0
    return residuals


def _indicators(keys: Sequence[object]) -> Floats:
    values = list(dict.fromkeys(keys))
    indices = np.array([values.index(key) for key in keys])
    return np.asarray(indices[:, None] == np.arange(len(values)), dtype=np.float64)
