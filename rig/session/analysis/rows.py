"""What an analysis works on: one row for each trial, one for each run (a search through the stiffnesses).

Stiffness, damping, effort, velocity and position are in the units of the rig (`rig.core.sample.unit_of`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rig.session.search.catching import CatchTrials
from rig.session.search.rule import Censored

Measure = Literal["rule", "K50 person", "K50 automatic"]
# How the limit of a run is told from its verdicts: by the rule that asked for them, from the verdicts that it followed;
# or as the stiffness that is stable half of the time, from the person's or the automatic verdicts, whatever rule asked.
MEASURES: tuple[Measure, ...] = ("rule", "K50 person", "K50 automatic")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRow:
    """One recorded hit.

    Attributes
    ----------
    place
        Of its run in the session, from 1; 0 for practice.
    automatic
        Automatic verdict: stable, limit cycle, unstable or invalid.
    passes
        Whether the wall holds under the study's criterion; None where the trial says nothing about it.
    verdict, by, took_s
        Of the person (stable, buzz, unstable, unsure), or of whoever stood in; empty and None before it.
    void
        Why it does not count: "redone", "restarted", "left out", "invalid", "not judged"; empty when it counts.
    amended
        Whether its verdict was corrected afterwards.
    recorded
        "ok", "missing", "changed", "not checked", or "none" when nothing moved.
    started_s
        When it was logged, after the session's begin, pauses included.
    """

    participant: str
    row: int
    block: int
    run: int
    place: int
    trial: int
    attempt: int
    condition: str
    scheme: str
    damping: float
    repeat: int
    stiffness: float
    track: int
    catch: bool
    practice: bool
    automatic: str
    passes: bool | None
    verdict: str
    by: str
    took_s: float | None
    void: str
    amended: bool
    ended: str
    aborted: str
    started_s: float
    heat: float
    felt: float | None
    heard: float | None
    moved: float | None
    peak_penetration: float | None
    peak_effort: float | None
    impact_velocity: float | None
    saturated_fraction: float | None
    baseline_velocity: float | None
    baseline_effort: float | None
    recording: str
    recorded: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticipantRow:
    """One participant.

    Attributes
    ----------
    began
        When, as ISO 8601 in UTC; in a rehearsal an arbitrary day.
    ended
        "complete", the rule that ended the session, or empty while it is not over.
    active_s
        Time of the session, long pauses aside.
    trials, counted
        Recorded, and those that made the limits.
    caught
        What catch trials showed.
    answers
        To the questionnaire, by item, of those asked at the start or the end.
    """

    participant: str
    row: int
    began: str
    ended: str
    active_s: float
    trials: int
    counted: int
    caught: CatchTrials
    answers: dict[str, str | int]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerRow:
    """An answer to the questionnaire: `when` is start, block or end; `block` 0 unless it was asked after one."""

    participant: str
    item: str
    when: str
    block: int
    answer: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """Where a limit lies: value, interval of 95 %, and the end of the levels beyond which it lies ("above", "below").

    There the interval is open: `high` is infinite, or `low` zero.

    `share` is the share of stable verdicts at the value; None for the ascending rule, which aims at none.
    """

    value: float
    low: float
    high: float
    censored: Censored
    share: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRow:
    """One search: one condition, one damping, one repeat.

    Attributes
    ----------
    block, order, place
        Number of the block, place in it, and place in the session, all from 1.
    rule
        That asked, and `followed`: whose verdicts it followed, "person" or "automatic".
    limits
        By measure; K50 is the median of its posterior. A measure is left out when nothing tells it: no verdicts, or the
        rule's own after verdicts were amended that it had followed (then the walls it asked for are no longer those of
        its walk).
    state
        "complete", "unfinished", or "skipped".
    trials, invalid, void
        Recorded hits that count; among all, those that said nothing; and those redone, restarted or left out.
    hits
        Verdicts that the rule heard.
    caught
        What catch trials showed; those at an end of the levels beyond which the limit lies are not counted.
    middle
        Mean number of its trials: when in the session it was.
    note
        Why a measure is missing, or what else must be known of a limit; mostly empty.
    """

    participant: str
    row: int
    block: int
    order: int
    run: int
    place: int
    condition: str
    scheme: str
    damping: float
    repeat: int
    rule: str
    followed: str
    limits: dict[Measure, Limit]
    state: str
    trials: int
    invalid: int
    void: int
    hits: int
    caught: CatchTrials
    middle: float
    note: str = ""

    @property
    def catches(self) -> int:
        """Catch trials that were counted."""
        return self.caught.count

    @property
    def lapses(self) -> int:
        """Those judged against what is known."""
        return self.caught.lapses


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """One value that K_max and the mixed model are made of.

    By the rule, a run's limit. As K50, that of all verdicts of a participant under a condition at a damping: a single
    run may tell K50 so badly (a series has one verdict that is not stable, which may be a lapse) that a mean over runs
    would be where it was looked for, not where it is.

    Attributes
    ----------
    order, block
        Place in the block, and number of it; means over the runs behind the value.
    runs
        How many are behind it.
    """

    measure: Measure
    participant: str
    condition: str
    damping: float
    order: float
    block: float
    runs: int
    limit: Limit
