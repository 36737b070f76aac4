"""The plan of a study, as values: searches, trials, times, order and checks."""

from __future__ import annotations

from dataclasses import dataclass

from rig.core.check import Check, Outcome
from rig.core.present import reported
from rig.core.sample import Motion
from rig.session.planning._expected import NOTHING, Expected, ExpectedRange, ExpectedTrials
from rig.session.planning._times import Heat, Taken, TrialTimes


@dataclass(frozen=True, slots=True, kw_only=True)
class CellPlan:
    """One condition at one damping.

    Attributes
    ----------
    scheme
        What a legend calls its rates and its estimator.
    rule, levels
        Who decides, and among which stiffnesses.
    expected
        Where its limit lies by theory.
    trials
        Of one search, and how many of its walls do not hold.
    unstable_free, unstable_in_hand
        Levels that linear theory calls unstable without a hand on the handle, and in one hand at least; None where it
        gives no limit.
    fit
        What a person must fit to the rig for it, in a time of its own; empty for nothing.
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
    """The plan of a study.

    Attributes
    ----------
    title, rig, motion, kind
        What it is about, and who hits.
    participants, rows
        How many are planned, and after how many the order is balanced.
    blocks, runs, practice
        Of one session.
    cells
        Condition by condition and damping by damping.
    trials
        Of one session, practice included.
    trial
        Parts of one trial at a wall in the middle.
    taken
        What finished sessions say of people's times, which then stand in `trial` and `duration_s`; None: as planned.
    duration_s
        Of one session by what it goes into; their sum is `session_s`.
    trial_bytes, disk_bytes
        Room for one recording, and for a participant's.
    rehearsal_s
        What a rehearsal costs a computer, roughly.
    heat
        Of the motor at the stiffest wall.
    orders
        For each participant the names of the runs by block.
    hidden, blinded
        Who does not see what, and whether that is the operator: then the orders are not for everybody.
    checks
        All comparisons.
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
        """Return the expected duration of a session (s)."""
        return sum(self.duration_s.values(), NOTHING)

    @reported
    def ok(self) -> bool:
        """Return True if nothing is refused."""
        return all(check.outcome is not Outcome.REFUSED for check in self.checks)
