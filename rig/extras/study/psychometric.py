"""Fit psychometric functions: stiffness at which verdicts change, how gradually, and how often a person lapses.

The posterior is computed on the grid of `rig.session.search._psychometric`, from all verdicts of a participant's
complete runs under a condition at one damping, for any search rule; catch trials are left out.
"""

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rig.extras.study.kmax import rounding_of, student
from rig.extras.study.rows import RunRow
from rig.extras.study.study import Study
from rig.extras.study.trials import answers, half_way, levels_by_participant
from rig.session.search import LAPSE_RATES, of_levels, rounding_deviation, share_stable, verdicts_of

Floats = NDArray[np.float64]
Judge = Literal["person", "automatic"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Posterior:
    """Estimate of a parameter: mean of the posterior (for K50 its median) and 95 % interval (NaN: no interval)."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PsychometricFit:
    """Psychometric function of one participant, or of all participants together (`participant` is empty).

    Attributes
    ----------
    judge
        Source of the verdicts, "person" or "automatic".
    participants
        Number of participants whose verdicts were used.
    threshold, spread
        K50 (stiffness with half of the verdicts stable) and scale s, in units of stiffness. If K50 lies beyond the
        levels (searched stiffnesses), it is the nearest level; over participants it is the mean of their K50.
    above, below
        Number of participants whose K50 lies above or below the levels.
    lapse_rate
        λ, the share of inverted verdicts (0 to 1).
    levels, verdicts, stable
        For each judged level: stiffness, number of verdicts, and number of stable verdicts.
    step, mark
        Distance of the levels around K50 (stiffness); why the verdicts do not support K50, empty if they do.
    """

    participant: str
    condition: str
    damping: float
    judge: Judge
    participants: int
    threshold: Posterior
    above: int
    below: int
    spread: Posterior
    lapse_rate: Posterior
    levels: tuple[float, ...]
    verdicts: tuple[int, ...]
    stable: tuple[int, ...]
    step: float
    mark: str

    @property
    def bounded(self) -> bool:
        """True if every participant's K50 (stiffness with half of the verdicts stable) lies within the range."""
        return not self.above and not self.below

    def share(self, stiffness: Floats) -> Floats:
        """Return the share of stable verdicts (0 to 1) at each stiffness."""
        return share_stable(stiffness, self.threshold.mean, self.spread.mean, self.lapse_rate.mean)


Verdicts = list[tuple[float, bool]]


def psychometrics(
    study: Study, complete: Container[tuple[str, int]], *, include_marked: bool = False
) -> tuple[PsychometricFit, ...]:
    """Fit all functions, by judge, condition and damping: of each participant, then of all participants together.

    `complete` has participant and number of each run (search) that counts. Participants whose fit is marked (not
    supported by the verdicts) are left out of the common function, unless `include_marked`.
    """
    found: list[PsychometricFit] = []
    judges: tuple[Judge, ...] = ("person", "automatic")
    grids = levels_by_participant(study)
    for judge in judges:
        by_cell = gather_verdicts(study, judge, complete)
        for condition in study.protocol.condition:
            name = condition.name
            for damping in condition.damping:
                verdicts = by_cell.get((name, damping), {})
                each = [
                    fit(code, name, damping, judge, grids[code, name], of) for code, of in verdicts.items()
                ]
                found += each
                kept = [one for one in each if include_marked or not one.mark]
                if len(kept) > 1:
                    codes = [one.participant for one in kept]
                    every = sorted({level for code in codes for level in grids[code, name]})
                    found.append(
                        together(kept, tuple(every), [one for code in codes for one in verdicts[code]])
                    )
    return tuple(found)


def complete_runs(runs: Sequence[RunRow]) -> set[tuple[str, int]]:
    """Return (participant, number) of each complete search (run)."""
    return {(run.participant, run.run) for run in runs if run.state == "complete"}


def gather_verdicts(
    study: Study, judge: str, complete: Container[tuple[str, int]]
) -> dict[tuple[str, float], dict[str, Verdicts]]:
    """Return verdicts as (stiffness, stable), by (condition, damping) and participant.

    `judge` is the source of the verdicts ("person" or "automatic"); `complete` has participant and number of each run
    that counts.
    """
    found: dict[tuple[str, float], dict[str, Verdicts]] = {}
    for session in study.sessions:
        for block in session.state.blocks:
            for run in () if block.practice else block.runs:
                counts = (session.code, run.number) in complete
                verdicts = verdicts_of(answers(session.state, run, judge)) if counts else []
                if verdicts:
                    cell = found.setdefault((run.condition, run.damping), {})
                    cell.setdefault(session.code, []).extend(verdicts)
    return found


def fit(
    participant: str,
    condition: str,
    damping: float,
    judge: Judge,
    levels: tuple[float, ...],
    verdicts: Sequence[tuple[float, bool]],
) -> PsychometricFit:
    """Fit one participant's psychometric function to verdicts (stiffness, stable) on the stiffnesses `levels`."""
    grid = of_levels(tuple(levels))
    posterior = grid.posterior(verdicts)
    half = half_way(levels, verdicts)
    by_level = {
        level: [stable for _, stable in group]
        for level, group in groupby(sorted(verdicts), key=lambda verdict: verdict[0])
    }
    return PsychometricFit(
        participant=participant,
        condition=condition,
        damping=damping,
        judge=judge,
        participants=1,
        threshold=Posterior(mean=half.value, low=half.low, high=half.high),
        above=int(half.censored == "above"),
        below=int(half.censored == "below"),
        spread=_marginal(grid.spreads, posterior.sum(axis=(0, 2)), geometric=True),
        lapse_rate=_marginal(np.array(LAPSE_RATES), posterior.sum(axis=(0, 1))),
        levels=tuple(by_level),
        verdicts=tuple(len(stable) for stable in by_level.values()),
        stable=tuple(sum(stable) for stable in by_level.values()),
        step=half.step,
        mark=half.mark,
    )


def together(
    each: Sequence[PsychometricFit], levels: tuple[float, ...], verdicts: Sequence[tuple[float, bool]]
) -> PsychometricFit:
    """Fit the common psychometric function of several participants under one condition to all of their verdicts.

    K50 (stiffness with half of the verdicts stable) is the mean of the single fits `each`, with Student's interval.
    """
    # Student's interval over people's own K50: it shows a K50 that drifts between repeats, for which the posterior's is
    # too narrow.
    own = np.array([one.threshold.mean for one in each])
    interval = student(own, rounding_of([rounding_deviation(one.step) for one in each]))
    pooled = fit("", each[0].condition, each[0].damping, each[0].judge, levels, verdicts)
    return replace(
        pooled,
        participants=len(each),
        mark=f"{marked} of {len(each)} participants' values are marked"
        if (marked := sum(one.mark != "" for one in each))
        else "",
        threshold=Posterior(mean=float(own.mean()), low=interval.low, high=interval.high),
        above=sum(one.above for one in each),
        below=sum(one.below for one in each),
        # Of all verdicts together, where differences between people widen it; no interval, since one person's verdicts
        # are no independent draws from all people.
        spread=Posterior(mean=pooled.spread.mean, low=math.nan, high=math.nan),
        lapse_rate=Posterior(mean=pooled.lapse_rate.mean, low=math.nan, high=math.nan),
    )


def _marginal(values: Floats, weights: Floats, *, geometric: bool = False) -> Posterior:
    """Return mean (or geometric mean) and 95 % interval of a parameter with discrete `values`, weighted."""
    share = weights / weights.sum()
    below = np.cumsum(share)
    low, high = (min(int(np.searchsorted(below, edge)), len(values) - 1) for edge in (0.025, 0.975))
    mean = np.exp(share @ np.log(values)) if geometric else share @ values
    return Posterior(mean=float(mean), low=float(values[low]), high=float(values[high]))
