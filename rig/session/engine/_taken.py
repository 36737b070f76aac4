"""Compute how long people took in the finished sessions of a study; the medians replace the assumptions of a plan.

The log has the times of events only. The time that people need before a trial is the time from the event before it to
its own event, minus the planned duration of the rig's part: homing, free space, hit and release.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import median

from rig.core.errors import RigError
from rig.session.engine._directory import LOG
from rig.session.engine._log import Event, read
from rig.session.engine._state import SessionState
from rig.session.planning._protocol import Protocol, Trial
from rig.session.planning._times import QUESTION_S, Taken


def find_taken(protocol: Protocol, study: Path) -> Taken | None:
    """Return the median times (s) that people took in earlier finished sessions whose trials had the same course.

    `study` is the directory of the participants; sessions that cannot be read are ignored. Return None without
    sessions.
    """
    logs = [events for path in sorted(study.glob(f"*/{LOG}")) if (events := _read_finished(protocol, path))]
    steps = [step for events in logs for step in _steps(events)]
    durations_s = {kind: [s for name, s in steps if name == kind] for kind in ("trial", "judged", "answered")}
    if not durations_s["trial"]:
        return None
    return Taken(
        sessions=len(logs),
        trials=len(durations_s["trial"]),
        trial=median(durations_s["trial"]),
        verdict=median(durations_s["judged"] or [0.0]),
        question=median(durations_s["answered"] or [QUESTION_S]),
    )


def _read_finished(protocol: Protocol, path: Path) -> Sequence[Event]:
    """Return the events of a session that has ended, is no rehearsal, and had the same kind of trials; otherwise ()."""
    try:
        events = read(path)
        state = SessionState.of(events)
    except (RigError, KeyError, TypeError, ValueError):
        # These times only improve an estimate: a session that cannot be read is left out.
        return ()
    same = _trial_timing(state.protocol) == _trial_timing(protocol)
    return events if state.ended is not None and state.rehearsal is None and same else ()


def _trial_timing(protocol: Protocol) -> tuple[str, Trial]:
    return protocol.study.judge, replace(protocol.trial, ready_s=0.0, verdict_s=0.0, fastest_verdict_s=0.0)


def _steps(events: Sequence[Event]) -> Iterator[tuple[str, float]]:
    """Yield the kind of each event and the time since the event before (s), without practice."""
    for before, after in pairwise(events):
        # A verdict counts only directly after its trial: with a note or a pause in between, the time is not the
        # response time of a person.
        if not after.content.get("practice") and (after.kind != "judged" or before.kind == "trial"):
            yield after.kind, after.at - before.at
