"""Compute the tables of participants and of their answers, and count trials by their use.

`analyse` uses it. It must not decide which trials count: the session's log does.
"""

from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime

from rig.extras.study.rows import ENDED_BY_MOST, AnswerRow, ParticipantRow, RunRow, TrialRow
from rig.extras.study.study import Study, StudySession
from rig.session.search import CatchTrials


def participants_of(
    study: Study, trials: Sequence[TrialRow], runs: Sequence[RunRow]
) -> tuple[ParticipantRow, ...]:
    """Return a row for each session: participant, duration, number of trials, answers."""
    return tuple(_row(session, trials, runs) for session in study.sessions)


def answers_of(study: Study) -> tuple[AnswerRow, ...]:
    """Return the final answer to each questionnaire item, without earlier answers of a restarted block."""
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


def count_trial_uses(trials: Sequence[TrialRow], runs: Sequence[RunRow]) -> Counter[str]:
    """Count trials by use: "counted" trials contribute to a limit; each other use names the reason why not.

    An unsure verdict is not "counted", unless it is the last of several in a row that the protocol treats as not
    stable.
    """
    states = {(run.participant, run.run): run.state for run in runs}
    return Counter(_use_of(trial, states.get((trial.participant, trial.run), "complete")) for trial in trials)


def _use_of(trial: TrialRow, state: str) -> str:
    if trial.practice:
        return "practice"
    if trial.void:
        return trial.void
    if state == ENDED_BY_MOST:
        return "in searches stopped at the trial limit"
    if state != "complete":
        return f"in {state} searches"
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
        counted=count_trial_uses(theirs, searches)["counted"],
        caught=sum((run.caught for run in searches), CatchTrials()),
        answers={item: answer for (item, _), answer in session.state.answered.items() if item in asked_once},
    )
