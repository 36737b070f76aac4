"""The rows of an analysis: one for each trial, one for each run (a search through the stiffnesses).

Unit (or quantity, `rig.core.sample.unit_of`) and meaning of each column are annotations of its field. The tables on
disk, their dictionary and the metadata of exports are generated from them.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from rig.core.quantity import Quantity
from rig.session.finished import RecordedTrial
from rig.session.search import CatchTrials, Censored, rounding_deviation

Measure = Literal["rule", "K50 person", "K50 automatic"]
# How the limit of a run is estimated: by the rule that asked for its walls, from the verdicts that it followed;
# or as the stiffness that is stable half of the time, from the person's or the automatic verdicts, whatever rule asked.
ENDED_BY_MOST = "ended by most"  # state of a search that reached its trial limit before its reversals
MEASURES: tuple[Measure, ...] = ("rule", "K50 person", "K50 automatic")


@dataclass(kw_only=True)
class TrialRow(RecordedTrial):
    """A trial of the log: participant, place in the study, person's verdict, and measured values (ripples, efforts)."""

    participant: Annotated[str, Quantity("", "code")]
    row: Annotated[int, Quantity("", "participant's row of the order, from 0")]
    place: Annotated[int, Quantity("", "of the run in the session, from 1; 0 is practice")]
    scheme: Annotated[str, Quantity("", "sampling and estimator of the condition")]
    automatic_stable: Annotated[
        bool | None, Quantity("", "whether the wall is stable under the study's criterion; empty: invalid")
    ]
    amended: Annotated[bool, Quantity("", "whether the verdict was corrected afterwards")]
    since_begin_s: Annotated[
        float, Quantity("s", "from the start of the session until the hit was logged, pauses included")
    ]
    felt: Annotated[
        float | None,
        Quantity("velocity", "rms velocity ripple in the tail, 30 to 500 Hz; empty: not measurable"),
    ]
    heard: Annotated[float | None, Quantity("effort", "rms effort ripple in the tail, above 30 Hz")]
    moved: Annotated[
        float | None, Quantity("position", "peak-to-peak position ripple in the tail, above 30 Hz")
    ]
    peak_penetration: Annotated[float | None, Quantity("position", "deepest")]
    peak_effort: Annotated[float | None, Quantity("effort", "largest, commanded")]
    impact_velocity: Annotated[float | None, Quantity("velocity", "at first contact")]
    press: Annotated[float | None, Quantity("effort", "mean effort in the tail, positive out of the wall")]
    saturated_fraction: Annotated[float | None, Quantity("1", "share of ticks at the limit of effort")]
    baseline_velocity: Annotated[float | None, Quantity("velocity", "rms in free space before the hit")]
    baseline_effort: Annotated[float | None, Quantity("effort", "rms in free space before the hit")]
    recorded: Annotated[
        str,
        Quantity(
            "",
            "recording compared with its hash in the log: ok, missing, changed, not checked; none: no recording",
        ),
    ]

    @property
    def counts(self) -> bool:
        """True if the trial is neither void nor practice, so that it can contribute to a limit."""
        return not self.void and not self.practice


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticipantRow:
    """One participant's session; `answers` has, by item, the answers that were asked once, at the start or the end."""

    participant: Annotated[str, Quantity("", "code")]
    row: Annotated[int, Quantity("", "of the order, from 0")]
    began: Annotated[
        str, Quantity("", "start of the session, ISO 8601 in UTC; for a rehearsal an arbitrary day")
    ]
    ended: Annotated[str, Quantity("", "complete, or the rule that ended the session; empty if unfinished")]
    active_s: Annotated[float, Quantity("s", "duration of the session without long pauses")]
    trials: Annotated[int, Quantity("", "recorded hits")]
    counted: Annotated[int, Quantity("", "trials used for limits")]
    caught: CatchTrials
    answers: dict[str, str | int]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerRow:
    """One answer to an item of the questionnaire."""

    participant: Annotated[str, Quantity("", "code")]
    item: Annotated[str, Quantity("", "name in the protocol")]
    when: Annotated[str, Quantity("", "start, block or end")]
    block: Annotated[int, Quantity("", "block after which it was asked; 0: at the start or the end")]
    answer: Annotated[str, Quantity("", "the answer given; corrections included")]


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitInterval:
    """A stiffness limit with its 95 % interval.

    `censored` is "above" or "below" if the limit lies beyond the searched levels (stiffnesses); the interval is then
    open: `high` is infinite, or `low` is zero. `share` is the share of stable verdicts at the value; None for the
    ascending rule, which has no target share. `step` is the distance of the levels around the value; 0 if the value is
    not from levels. `mark` gives the reason if the verdicts do not support the value
    (`rig.session.search._rule.mark_contradictions`); such a limit is left out by default.
    """

    value: float
    low: float
    high: float
    censored: Censored
    share: float | None
    step: float = 0.0
    mark: str = ""

    @property
    def rounding(self) -> float:
        """Standard deviation of the error that rounding to the searched stiffnesses makes, in units of stiffness."""
        return rounding_deviation(self.step)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRow:
    """One search (run): one condition, one damping, one repeat.

    `limits` contains the stiffness limit by each definition ("rule", "K50 …"); K50 is the median of its posterior. A
    limit is missing if nothing determines it: there are no verdicts or, for the rule, verdicts that the search had used
    were amended afterwards, so that it would have chosen other walls. `caught` does not count catch trials at an end of
    the levels beyond which the limit lies.
    """

    participant: Annotated[str, Quantity("", "code")]
    row: Annotated[int, Quantity("", "participant's row of the order, from 0")]
    block: Annotated[int, Quantity("", "number from 1")]
    run: Annotated[int, Quantity("", "number over the session from 1")]
    place: Annotated[int, Quantity("", "in the session, from 1")]
    order: Annotated[int, Quantity("", "place in the block, from 1")]
    condition: Annotated[str, Quantity("", "name in the protocol")]
    scheme: Annotated[str, Quantity("", "sampling and estimator of the condition")]
    damping: Annotated[float, Quantity("damping", "B of the wall")]
    repeat: Annotated[int, Quantity("", "of this condition and damping, from 1")]
    rule: Annotated[str, Quantity("", "search rule")]
    followed: Annotated[
        str, Quantity("", "source of the verdicts that the search rule used: person or automatic")
    ]
    state: Annotated[
        str,
        Quantity(
            "",
            "complete, unfinished, skipped, or ended by most (too few turns); only complete runs are used for K_max",
        ),
    ]
    limits: dict[Measure, LimitInterval]
    trials: Annotated[int, Quantity("", "number of judged hits that count")]
    invalid: Annotated[int, Quantity("", "invalid hits")]
    voided: Annotated[int, Quantity("", "number of hits redone, restarted or excluded")]
    hits: Annotated[int, Quantity("", "number of verdicts that the search rule used")]
    caught: CatchTrials
    middle_trial: Annotated[float, Quantity("", "mean trial number, the run's position in the session")]
    note: Annotated[str, Quantity("", "why a limit is missing, or a remark about it")] = ""

    @property
    def catches(self) -> int:
        """Number of catch trials that count."""
        return self.caught.count

    @property
    def lapses(self) -> int:
        """Number of catch trials with a wrong verdict."""
        return self.caught.lapses


def runs_as_counted(runs: Iterable[RunRow], *, include_marked: bool = False) -> tuple[RunRow, ...]:
    """Return the runs (searches) as K_max, models and slopes use them.

    Doubtful (marked) limits are removed, and a run that stopped at its trial limit is not complete, unless
    `include_marked`.
    """
    if include_marked:
        return tuple(replace(run, state="complete") if run.state == ENDED_BY_MOST else run for run in runs)
    return tuple(
        replace(run, limits={measure: limit for measure, limit in run.limits.items() if not limit.mark})
        for run in runs
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """One stiffness limit of a participant that K_max and the mixed model use.

    For the rule it is the limit of a run. For K50 it is the limit from all verdicts of a participant under a condition
    at a damping, because a single run may determine K50 badly: if its only verdict "not stable" is a lapse, its K50
    lies where the search looked for it, and so does a mean over runs.

    Attributes
    ----------
    order, block
        Place in the block, and number of the block; means over the runs that were used.
    runs
        Number of runs that were used.
    """

    measure: Measure
    participant: str
    condition: str
    damping: float
    order: float
    block: float
    runs: int
    limit: LimitInterval
