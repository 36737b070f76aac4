"""Data classes for the plan of a study: searches, trials, durations, order and results of checks.

`rig.session.engine._check` fills them; `rig session check` and the page show them.
"""

from dataclasses import dataclass

from rig.core.check import Check, Outcome
from rig.core.present import reported
from rig.core.sample import Motion
from rig.session.planning._expected import NOTHING, Expected, ExpectedRange, ExpectedTrials
from rig.session.planning._times import Heat, Taken, TrialTimes


@dataclass(frozen=True, slots=True, kw_only=True)
class CellPlan:
    """Plan of one search for the stiffest stable wall: a condition at one damping.

    Attributes
    ----------
    scheme
        Short name of sampling rates and estimator, for legends.
    rule, levels
        Name of the search rule, which chooses the next wall, and the levels of stiffness from which it chooses.
    expected
        Expected limit by linear theory.
    trials
        Expected numbers of trials, and of trials with unstable walls.
    unstable_free, unstable_in_hand
        Levels that are unstable by linear theory: without a hand, and with at least one kind of grip; None if theory
        gives no limit.
    fit
        Part that a person must fit to the rig for this condition; empty for none.
    """

    condition: str
    damping: float
    scheme: str
    rule: str
    levels: tuple[float, ...]
    expected: Expected
    trials: ExpectedTrials
    unstable_free: tuple[float, ...] | None
    unstable_in_hand: tuple[float, ...] | None
    fit: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyPlan:
    """Plan of a study.

    Attributes
    ----------
    title, rig, motion, kind
        Title of the study, name and motion of the rig, and kind of trial.
    participants, rows
        Planned number of participants, and number of participants after which the order of conditions is balanced.
    blocks, runs, practice
        Numbers of blocks (groups of searches), searches and practice trials in a session.
    cells
        Plan of each search: every condition at each of its dampings.
    trials
        Expected number of trials in a session, practice included.
    trial
        Durations of the parts of one trial (s).
    taken
        Times of people measured in finished sessions, which `trial` and `duration_s` then use; None without sessions.
    duration_s
        Expected duration of each part of a session (s); `session_s` is their sum.
    trial_bytes, disk_bytes
        Disk space for one recording, and for all recordings of a participant (bytes).
    rehearsal_s
        Approximate computing time of a session with a simulated person (s).
    heat
        Heating of the motor at the stiffest wall.
    orders
        Names of the searches in each block, for each participant.
    hidden, blinded
        Sentences about what is hidden from whom, and True if the operator is blinded, who must then not see `orders`.
    checks
        Results of all checks.
    """

    title: str
    rig: str
    motion: Motion
    kind: str
    participants: int
    rows: int
    blocks: int
    runs: int
    practice: int
    cells: tuple[CellPlan, ...]
    trials: ExpectedRange
    trial: TrialTimes
    taken: Taken | None
    duration_s: dict[str, ExpectedRange]
    trial_bytes: float
    disk_bytes: ExpectedRange
    rehearsal_s: ExpectedRange
    heat: Heat
    orders: tuple[tuple[tuple[str, ...], ...], ...]
    hidden: tuple[str, ...]
    blinded: bool
    checks: tuple[Check, ...]

    @reported
    def session_s(self) -> ExpectedRange:
        """Expected duration of a session (s)."""
        return sum(self.duration_s.values(), NOTHING)

    @reported
    def ok(self) -> bool:
        """True if no check of the plan has failed, so that the study may begin."""
        return all(check.outcome is not Outcome.REFUSED for check in self.checks)
