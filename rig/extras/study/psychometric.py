"""Fit psychometric functions: where verdicts change from stable to not, how gradually, and how often a person lapses.

The posterior on the grid of `rig.session.search._psychometric`, of all verdicts of a participant's complete runs under
a condition at one damping, whatever rule asked for them; catch trials are left out, as in the searches.
"""

from __future__ import annotations

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
    """A parameter: posterior mean, of K50 the median, and interval of 95 % (NaN: none)."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PsychometricFit:
    """The function of one participant, or of all (`participant` is empty then).

    Attributes
    ----------
    judge
        Whose verdicts.
    participants
        How many are behind it.
    threshold, spread
        K50 and s, in the units of stiffness. Beyond the levels K50 is their end, see
        `rig.session.search._psychometric.Located`; over participants the mean of theirs.
    above, below
        How many of the participants behind it have their K50 above or below the levels.
    lapse_rate
        λ, the share of verdicts turned round.
    levels, verdicts, stable
        Of each level that was judged: stiffness, verdicts, and how many of them were stable.
    step, mark
        Distance of the levels about K50; and why K50 is no limit that the verdicts show, as of a `LimitInterval`.
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
        """Return True if every K50 behind it lies among the levels."""
        return not self.above and not self.below

    def share(self, stiffness: Floats) -> Floats:
        """Share of stable verdicts along stiffness, at these parameters."""
        return share_stable(stiffness, self.threshold.mean, self.spread.mean, self.lapse_rate.mean)


Verdicts = list[tuple[float, bool]]


def psychometrics(
    study: Study, complete: Container[tuple[str, int]], *, include_marked: bool = False
) -> tuple[PsychometricFit, ...]:
    """All functions: by judge, condition and damping, each participant and then all of them (without marked ones).

    Parameters
    ----------
    complete
        Participants and numbers of the runs that count, see `complete_runs`.
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
    """Return participants and numbers of the runs that limits are made of."""
    return {(run.participant, run.run) for run in runs if run.state == "complete"}


def gather_verdicts(
    study: Study, judge: str, complete: Container[tuple[str, int]]
) -> dict[tuple[str, float], dict[str, Verdicts]]:
    """Return verdicts by condition and damping, and by participant.

    Parameters
    ----------
    judge
        See `rig.extras.study.trials.answers`.
    complete
        Participants and numbers of the runs that count.
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
    """Return the function that verdicts (stiffness, stable) of one participant on these levels show."""
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
    """Return the function of several participants under one condition, of whose verdicts these are all."""
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
    """Mean (of the logarithm, if geometric) and interval of a parameter that has few values, from value to value."""
    share = weights / weights.sum()
    below = np.cumsum(share)
    low, high = (min(int(np.searchsorted(below, edge)), len(values) - 1) for edge in (0.025, 0.975))
    mean = np.exp(share @ np.log(values)) if geometric else share @ values
    return Posterior(mean=float(mean), low=float(values[low]), high=float(values[high]))
