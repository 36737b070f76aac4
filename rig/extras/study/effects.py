"""Estimate order and fatigue: whether limits, verdicts and trials change during a session.

The slopes were not planned: they are exploratory, and the p values of the slopes of one quantity are corrected for
their number (Holm).
"""

from __future__ import annotations

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
    of
        Quantity: "limit" (stiffness), "response time" (natural logarithm of s) or "invalid" (0 or 1).
    along
        Position in the session: "order" (place in the block), "block", or "trial" (number in the session).
    measure
        Measure of the limit; empty for the other quantities.
    count
        Number of values.
    participants
        Number of participants who have a slope.
    slope, low, high, p, holm
        Change per place, block or trial, its interval and p; NaN if `problem` gives a reason. `holm` is p after Holm's
        correction for the slopes of one quantity; the limits of each measure are one quantity.
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

    Attributes
    ----------
    trials
        Recorded trials, also those that do not count.
    invalid, redone, aborted
        Invalid trials; trials repeated at the operator's request; trials cut off for safety.
    unsure
        Verdicts "unsure".
    response_s
        Median time to a verdict (s); None without a verdict.
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
    """Compute the slopes along the session: of limits (by each definition), verdict times, and invalid trials."""
    found: list[Slope] = []
    places: tuple[tuple[str, Callable[[RunRow], float]], ...] = (
        ("order", lambda run: float(run.order)),
        ("block", lambda run: float(run.block)),
        ("trial", lambda run: run.middle_trial),
    )
    for measure in MEASURES:
        counted = [run for run in runs if run.state == "complete" and measure in run.limits]
        beyond = beyond_of((run.condition, run.damping, run.limits[measure]) for run in counted)
        # Mostly censored limits are the end of the levels, not of a person.
        counted = [run for run in counted if not beyond[run.condition, run.damping].mostly]
        limits = np.array([run.limits[measure].value for run in counted])
        cells = [(run.participant, run.condition, run.damping) for run in counted]
        family = []
        roundings = np.array([run.limits[measure].rounding for run in counted])
        for name, place in places:
            at = np.array([place(run) for run in counted])
            slope = _estimate_slope("limit", name, measure, at, limits, cells, roundings)
            if beyond and not counted:
                slope = replace(slope, problem="most limits lie beyond the searched levels")
            family.append(slope)
        found += _correct_holm(family)
    kept = [trial for trial in trials if not trial.practice and trial.void not in VOIDED]
    timed = [
        t
        for t in kept
        if t.judged_by in ("person", "simulated")
        and t.response_time_s is not None
        and t.response_time_s > 0.0
    ]
    logs = [math.log(trial.response_time_s) for trial in timed if trial.response_time_s]
    useless = [float(trial.void == "invalid") for trial in kept]
    for what, of, values in (("response time", timed, logs), ("invalid", kept, useless)):
        at = np.array([float(trial.trial) for trial in of])
        each = [(trial.participant, trial.condition, trial.damping) for trial in of]
        found += _correct_holm([_estimate_slope(what, "trial", "", at, np.array(values), each)])
    return tuple(found)


def _correct_holm(family: Sequence[Slope]) -> list[Slope]:
    return [replace(one, holm=p) for one, p in zip(family, holm([one.p for one in family]), strict=True)]


def blocks(trials: Sequence[TrialRow]) -> tuple[BlockRow, ...]:
    """Summarise the trials of each participant's blocks, practice excluded."""
    groups: dict[tuple[str, int], list[TrialRow]] = {}
    for trial in trials:
        if not trial.practice:
            groups.setdefault((trial.participant, trial.block), []).append(trial)
    return tuple(_block(code, block, of) for (code, block), of in groups.items())


def _block(code: str, block: int, of: Sequence[TrialRow]) -> BlockRow:
    times = [
        t.response_time_s
        for t in of
        if t.judged_by in ("person", "simulated") and t.response_time_s is not None
    ]
    return BlockRow(
        participant=code,
        block=block,
        trials=len(of),
        invalid=sum(trial.void == "invalid" for trial in of),
        redone=sum(trial.void == "redone" for trial in of),
        aborted=sum(trial.aborted != "" for trial in of),
        unsure=sum(trial.verdict == "unsure" for trial in of),
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
    found = _average_slopes(each, _is_shared(cells), rounding)
    slope, low, high, p = (math.nan,) * 4 if isinstance(found, str) else found
    return Slope(
        of=of,
        along=along,
        measure=measure,
        count=len(values),
        participants=len(each),
        slope=slope,
        low=low,
        high=high,
        p=p,
        problem=found if isinstance(found, str) else "",
    )


def within_slopes(at: Floats, values: Floats, cells: Sequence[tuple[str, str, float]]) -> dict[str, float]:
    """Return the slope of `values` along `at` by participant, for participants whose values have different places.

    Parameters
    ----------
    at, values
        Place in the session, and value (same shape).
    cells
        Participant, condition and damping of each value.
    """
    if not cells:
        return {}
    moved, changed = less_means(at, cells), less_means(values, cells)
    codes = np.array([cell[0] for cell in cells])
    found = {}
    for code in dict.fromkeys(cell[0] for cell in cells):
        own = codes == code
        square = float(moved[own] @ moved[own])
        if square > 0.0:
            found[code] = float(moved[own] @ changed[own]) / square
    return found


def _rounding_of_slopes(
    at: Floats, roundings: Floats, cells: Sequence[tuple[str, str, float]], each: Mapping[str, float]
) -> float:
    """Return the standard deviation of the slopes that follows from rounding limits to the searched stiffnesses."""
    moved, codes = less_means(at, cells), np.array([cell[0] for cell in cells])
    own = [codes == code for code in each]
    return rounding_of(
        [float(np.linalg.norm(moved[of] * roundings[of]) / (moved[of] @ moved[of])) for of in own]
    )


def _average_slopes(
    each: Mapping[str, float], shared: bool, rounding: float
) -> tuple[float, float, float, float] | str:
    """Return mean, 95 % interval and p of the participants' slopes (Student), or the reason why they are missing.

    If `shared`, the means of the conditions are estimated from the same values, which takes one more degree of freedom:
    with two conditions, each searched once, this is the two-sample test of a crossover.
    """
    # A slope for each person, and Student's interval over these: an interval over trials would take 150 trials of a
    # person for 150 people.
    slopes = np.array(list(each.values()))
    count = len(slopes)
    if count == 0:
        return "this effect cannot be separated from participants and conditions"
    if count < LEAST_VALUES:
        return too_few_words(count, "participants with a slope of their own")
    if not np.any(slopes):
        return "all values are equal within participants and conditions"
    mean, free = float(slopes.mean()), count - (2 if shared else 1)
    rest = slopes - mean
    scatter = math.sqrt(float(rest @ rest) / free)
    if not is_resolved(scatter, rounding, float(np.abs(slopes).max())):
        return unresolved_words("the slopes of the participants", scatter, rounding)
    deviation = scatter / math.sqrt(count)
    low, high = stats.t.interval(0.95, free, mean, deviation)
    return mean, float(low), float(high), float(2.0 * stats.t.sf(abs(mean) / deviation, free))


def _is_shared(cells: Sequence[tuple[str, str, float]]) -> bool:
    """Return True if no participant has two values of one condition and damping; means then need all participants."""
    return len(set(cells)) == len(cells)


def less_means(values: Floats, cells: Sequence[tuple[str, str, float]]) -> Floats:
    """Return `values` minus the means of participants and conditions; rounding errors of the result become zero."""
    if not cells:
        return values
    if _is_shared(cells):
        fixed = np.column_stack([_indicators(of) for of in ([c[0] for c in cells], [c[1:] for c in cells])])
        left = np.asarray(values - fixed @ np.linalg.lstsq(fixed, values, rcond=None)[0])
    else:
        number = {cell: place for place, cell in enumerate(dict.fromkeys(cells))}
        of = np.array([number[cell] for cell in cells])
        left = np.asarray(values - (np.bincount(of, values) / np.bincount(of))[of])
    left[np.abs(left) <= FLOATING * np.abs(values).max()] = 0.0
    return left


def _indicators(keys: Sequence[object]) -> Floats:
    values = list(dict.fromkeys(keys))
    place = np.array([values.index(key) for key in keys])
    return np.asarray(place[:, None] == np.arange(len(values)), dtype=np.float64)
