"""Who took part: a row for each participant, and what they answered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime

from rig.extras.study.rows import ENDED_BY_MOST, AnswerRow, ParticipantRow, RunRow, TrialRow
from rig.extras.study.study import Study, StudySession
from rig.session.search import CatchTrials


def participants_of(
    study: Study, trials: Sequence[TrialRow], runs: Sequence[RunRow]
) -> tuple[ParticipantRow, ...]:
    """Return one row of the table of participants for each session."""
    return tuple(_row(session, trials, runs) for session in study.sessions)


def answers_of(study: Study) -> tuple[AnswerRow, ...]:
    """Return all answers, in the order in which they were given; corrections included."""
    when = {item.name: item.when for item in study.protocol.question}
    return tuple(
        AnswerRow(
            participant=session.code,
            item=item,
            when=when.get(item, ""),
            block=max(block, 0),
            answer=str(answer),
        )
        for session in study.sessions
        for (item, block), answer in session.state.answered.items()
    )


def fates(trials: Sequence[TrialRow], runs: Sequence[RunRow]) -> Counter[str]:
    """Count trials by their use: "counted" ones contribute to a limit, each other one has its reason.

    Unsure verdicts do not contribute, save the last of so many in a row that the protocol takes them for not stable.
    """
    states = {(run.participant, run.run): run.state for run in runs}
    return Counter(_fate(trial, states.get((trial.participant, trial.run), "complete")) for trial in trials)


def _fate(trial: TrialRow, state: str) -> str:
    if trial.practice:
        return "practice"
    if trial.void:
        return trial.void
    if state == ENDED_BY_MOST:
        return "of searches that ended by most"
    if state != "complete":
        return f"of {state} searches"
    return "catch trials" if trial.catch else "unsure" if trial.verdict == "unsure" else "counted"


def _row(session: StudySession, trials: Sequence[TrialRow], runs: Sequence[RunRow]) -> ParticipantRow:
    theirs = [trial for trial in trials if trial.participant == session.code]
    searches = [run for run in runs if run.participant == session.code]
    asked_once = {item.name for item in session.state.protocol.question if item.when != "block"}
    return ParticipantRow(
        participant=session.code,
        row=session.state.row,
        began=datetime.fromtimestamp(session.began_at, UTC).isoformat(timespec="seconds"),
        ended=session.state.ended or "",
        active_s=session.state.active_s,
        trials=len(theirs),
        counted=fates(theirs, searches)["counted"],
        caught=sum((run.caught for run in searches), CatchTrials()),
        answers={item: answer for (item, _), answer in session.state.answered.items() if item in asked_once},
    )
