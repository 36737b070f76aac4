"""How long people took in the finished sessions of a study: their medians replace what a plan assumes.

A log dates its events and not what people do in between. So *ready* is what a trial's line comes later than the line
before it, less what the rig takes by itself; homing, free space, hit and release stay as they are planned.
"""

from __future__ import annotations

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
    """Return the times that earlier participants took for the same trials; None if none of their sessions is finished.

    Parameters
    ----------
    study
        Directory of the participants. What is no session there, or cannot be read, counts for nothing.
    """
    logs = [events for path in sorted(study.glob(f"*/{LOG}")) if (events := _read_finished(protocol, path))]
    steps = [step for events in logs for step in _steps(events)]
    of = {kind: [s for name, s in steps if name == kind] for kind in ("trial", "judged", "answered")}
    if not of["trial"]:
        return None
    return Taken(
        sessions=len(logs),
        trials=len(of["trial"]),
        trial=median(of["trial"]),
        verdict=median(of["judged"] or [0.0]),
        question=median(of["answered"] or [QUESTION_S]),
    )


def _read_finished(protocol: Protocol, path: Path) -> Sequence[Event]:
    """Return the events of a participant's session that is over and had the same trials; none of another."""
    try:
        events = read(path)
        state = SessionState.of(events)
    except (RigError, KeyError, TypeError, ValueError):
        # These times only improve an estimate: a session that cannot be read is left out.
        return ()
    same = _trial_timing(state.protocol) == _trial_timing(protocol)
    return events if state.ended is not None and state.rehearsal is None and same else ()


def _trial_timing(protocol: Protocol) -> tuple[str, Trial]:
    """Return the settings that decide the duration of a trial, without the planned times of people."""
    return protocol.study.judge, replace(protocol.trial, ready_s=0.0, verdict_s=0.0, fastest_verdict_s=0.0)


def _steps(events: Sequence[Event]) -> Iterator[tuple[str, float]]:
    """Yield the kind of each event, and how long after the one before it came (s)."""
    for before, after in pairwise(events):
        if not after.content.get("practice") and (after.kind != "judged" or before.kind == "trial"):
            yield after.kind, after.at - before.at
