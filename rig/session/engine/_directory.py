"""The directory of one participant: begin a session, resume it after any end, and correct it.

session.log               every decision (`rig.session.engine._log`), from which the state of the session is computed
protocol.toml             copy of the protocol file at the start
trials/t0001.parquet …    recordings; the name contains the trial's number, but nothing about its wall
trials/abandoned/         recordings of trials that were not logged because the process died

A log and the recordings of a person are never deleted, only moved or corrected.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig import config
from rig.config import Experiment
from rig.core.errors import ConfigError, RecordingError
from rig.recording.files import make_directories, plain_errors, sha256_of, sync_directory, whole_file
from rig.session.engine._clock import SessionClock, WallClock
from rig.session.engine._log import Event, SessionLog, read, set_aside
from rig.session.engine._place import resume_command
from rig.session.engine._state import AMENDABLE, SessionState
from rig.session.planning._items import describe_answer, describe_item, parse_answer
from rig.session.planning._keymap import VERDICTS
from rig.session.planning._load import as_mapping, check_code
from rig.session.planning._names import directory_name
from rig.session.planning._protocol import Protocol

OF_TRIAL = {"void": True, "counts": False}  # corrections of a trial itself: exclude it, or include it again
WALL = WallClock()
SESSIONS, REHEARSALS = Path("sessions"), Path("rehearsals")
LOG, PROTOCOL, TRIALS, ABANDONED = "session.log", "protocol.toml", "trials", "abandoned"


@dataclass(kw_only=True)
class Session:
    """Open session of one participant; only one process at a time can open it.

    Attributes
    ----------
    directory
        Directory of the participant.
    log, state
        Log of the events so far, and the state that is computed from it.
    clock
        Clock for the times in the log.
    """

    directory: Path
    log: SessionLog
    state: SessionState
    clock: SessionClock = field(default_factory=WallClock)

    def record(self, kind: str, **content: Any) -> Event:
        """Write an event to the log, then update the state with it; return the event."""
        event = self.log.append(kind, **content)
        self.state.apply(event)
        return event

    def close(self) -> None:
        """Close the log and release the directory for other processes."""
        self.log.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def study_directory(protocol: Protocol, study: Path | None, *, rehearsal: bool = False) -> Path:
    """Return the directory of all participants of a study: `study` if given, otherwise one named after the title."""
    if study is not None:
        return study
    return (REHEARSALS if rehearsal else SESSIONS) / directory_name(protocol.study.title)


def begin(
    directory: Path,
    protocol: Protocol,
    experiment: Experiment,
    *,
    text: bytes,
    sha256: str,
    code: str,
    row: int,
    versions: Mapping[str, Any],
    rehearsal: Mapping[str, Any] | None = None,
    differs: Sequence[str] = (),
    clock: SessionClock = WALL,
) -> Session:
    """Begin the session of a participant in the participant's directory.

    Raise `ConfigError` if the code is not valid or the participant has a session already, and `RecordingError` if
    another process has the session open or writing fails. Nothing is overwritten.

    Parameters
    ----------
    directory
        Directory of the participant; created if it does not exist.
    protocol, experiment
        Protocol, and the experiment that it names (`rig.session.planning._conditions.base_of`).
    text, sha256
        Contents and SHA-256 of the protocol file, of which a copy is stored.
    code, row
        Code of the participant, and the participant's row (from 0) in the table of condition orders.
    versions, rehearsal, differs
        Further contents of the first event: versions of software, the simulated person (or None), and keys that have
        another value in the study's earlier sessions.
    clock
        Clock for the times in the log (s).
    """
    refuse_begun(protocol, directory, code)
    make_directories(directory / TRIALS)
    log = SessionLog(directory / LOG, clock=clock)
    try:
        if log.events:
            raise _begun(directory, log.events)
        with whole_file(directory / PROTOCOL, overwrite=True) as file:
            file.write(text)
        log.append(
            "began",
            protocol=as_mapping(protocol),
            protocol_sha256=sha256,
            experiment=config.as_mapping(experiment),
            code=code,
            row=row,
            seed=protocol.study.seed,
            versions=dict(versions),
            rehearsal=None if rehearsal is None else dict(rehearsal),
            differs=list(differs),
        )
        return Session(directory=directory, log=log, state=SessionState.of(log.events), clock=clock)
    except BaseException:
        # An open log locks its directory against the next attempt.
        log.close()
        raise


def refuse_begun(protocol: Protocol, directory: Path, code: str) -> None:
    """Raise `ConfigError` if the participant's code is not valid or the directory already contains a session."""
    check_code(protocol, code)
    if (directory / LOG).exists() and (events := read(directory / LOG)):
        raise _begun(directory, events)


def clear_rehearsal(directory: Path) -> None:
    """Delete the directory of a session with a simulated person; do nothing to any other directory."""
    events = read(directory / LOG) if (directory / LOG).exists() else []
    if events and events[0].content.get("rehearsal") is not None:
        shutil.rmtree(directory)


def _begun(directory: Path, events: Sequence[Event]) -> ConfigError:
    rehearsal = events[0].content.get("rehearsal") is not None
    return ConfigError(
        f"{directory} already contains a {'rehearsal with a simulated person' if rehearsal else 'session'} "
        f"({len(events)} events)",
        remedy=f"resume this one: {resume_command(directory, events)}; or give another "
        + ("code, or another directory for people with `study`" if rehearsal else "code"),
    )


def resume(directory: Path, *, at: str = "trial", clock: SessionClock = WALL) -> Session:
    """Resume a session that was interrupted, or that the operator left.

    Recordings without an event in the log are moved to trials/abandoned and listed in the log with their SHA-256. Raise
    `ConfigError` if the directory contains no session or the session has ended, and `RecordingError` if another process
    has the session open, the log is damaged, or writing fails.

    Parameters
    ----------
    directory
        Directory of the participant.
    at
        "trial": continue with the next trial. "block": repeat the current block; its trials so far do not count.
    clock
        Clock for the times in the log (s).
    """
    _refuse_no_session(directory)
    log = SessionLog(directory / LOG, clock=clock)
    try:
        if not log.events:
            raise ConfigError(
                f"the session in {directory} was interrupted before it began",
                remedy="start it again: rig session run",
            )
        clock.resume_at(log.events[-1].at)
        session = Session(directory=directory, log=log, state=SessionState.of(log.events), clock=clock)
        if session.state.ended is not None:
            raise ConfigError(
                f"the session in {directory} has ended ({session.state.ended}) and cannot be resumed",
                remedy="show it with rig session show, or correct it with rig session amend",
            )
        lost: dict[str, Any] = {"torn": log.torn} if log.torn else {}
        if damaged := _find_damaged(session):
            lost["damaged"] = damaged
        session.record("resumed", where=at, abandoned=_set_aside(session), **lost)
        block = session.state.open_block
        tried = {trial.block for trial in session.state.trials if not trial.void}
        if at == "block" and block is not None and block.number in tried:
            session.record("restarted", block=block.number)
        return session
    except BaseException:
        log.close()
        raise


def _refuse_no_session(directory: Path) -> None:
    with plain_errors("read", directory):
        if not (directory / LOG).is_file():
            raise ConfigError(
                f"{directory} is not the directory of a session: it contains no file {LOG}",
                remedy="give the directory of one participant",
            )


def event_of_trial(directory: Path, trial: int, value: str) -> int:
    """Return the number of the log's event that a correction of a trial must change.

    To exclude the trial ("void") or include it again ("counts") this is the event of the trial itself; for any other
    `value` it is the event of its verdict. Raise `ConfigError` if the session has no such event.
    """
    _refuse_no_session(directory)
    kind = "trial" if value in OF_TRIAL else "judged"
    events = [
        event for event in read(directory / LOG) if event.kind == kind and event.content["trial"] == trial
    ]
    if not events:
        raise ConfigError(
            f"{directory} has no trial {trial}" if kind == "trial" else f"trial {trial} has no verdict",
            remedy="list trials and verdicts with rig session show --log",
        )
    return events[-1].number


def amend(
    directory: Path, number: int, value: str, why: str, *, clock: Callable[[], float] = time.time
) -> Event:
    """Append a correction of event `number` to the log; the original event stays in the log.

    A verdict, the text of a note, and an answer can be corrected to `value`. A trial can be excluded ("void") or
    included again ("counts"). `why` is the reason. Raise `ConfigError` if the event cannot be corrected, the value is
    not valid or the reason is empty, and `RecordingError` if the log is open elsewhere or damaged, or writing fails.
    """
    _refuse_no_session(directory)
    with SessionLog(directory / LOG, clock=clock) as log:
        if not 0 <= number < len(log.events):
            raise ConfigError(
                f"the log in {directory} has no event {number}; its events have the numbers 0 to {len(log.events) - 1}",
                remedy="list the events with rig session show",
            )
        kind = log.events[number].kind
        if kind not in AMENDABLE:
            raise ConfigError(
                f"event {number} of the log is of the kind {kind!r}, which cannot be corrected",
                remedy=f"correct an event of the kind {', '.join(AMENDABLE)}; write anything else into a note",
            )
        (name,) = AMENDABLE[kind]
        if name == "verdict" and value not in VERDICTS:
            raise ConfigError(f"{value!r} is not a verdict", remedy=f"choose one of {', '.join(VERDICTS)}")
        if not why.strip():
            raise ConfigError(
                "a correction needs a reason, but `why` is empty", remedy="give the reason with `why`"
            )
        if name == "void" and value not in OF_TRIAL:
            raise ConfigError(
                f"event {number} is a trial, which cannot be corrected to {value!r}",
                remedy=f"choose one of {', '.join(OF_TRIAL)}; to correct its verdict, give its number as `trial`",
            )
        kept: str | int | bool = OF_TRIAL.get(value, value) if name == "void" else value
        if kind == "answered":
            kept = _corrected_answer(SessionState.of(log.events), log.events[number].content["item"], value)
        trial = log.events[number].content.get("trial")
        about = {} if not trial else {"trial": trial}
        return log.append("amended", number=number, field=name, value=kept, why=why, **about)


def _corrected_answer(state: SessionState, name: str, value: str) -> str | int:
    item = next((one for one in state.protocol.question if one.name == name), None)
    if item is None:
        return value
    kept = parse_answer(describe_item(item), value)
    if kept is None:
        raise ConfigError(
            f"{value!r} is not a valid answer to the question {name}",
            remedy=f"give {describe_answer(describe_item(item))}",
        )
    return kept


def _set_aside(session: Session) -> list[dict[str, str]]:
    """Move recordings that the log does not mention to trials/abandoned.

    Return file and SHA-256 of all recordings in that directory that the log does not list yet.
    """
    trials = session.directory / TRIALS
    aside = trials / ABANDONED
    logged = {Path(trial.recording).name for trial in session.state.trials if trial.recording}
    make_directories(trials)
    with plain_errors("read", trials):
        loose = sorted(path for path in trials.iterdir() if path.is_file() and path.name not in logged)
    # A recording without an event: the process died between both. Nothing was decided on it.
    if loose:
        make_directories(aside)
        with plain_errors("move", aside):
            for path in loose:
                os.rename(path, _free(aside, path))
    # Also a directory that a killed process moved aside. The new name is synced first: a power cut could
    # lose both otherwise.
    if aside.is_dir():
        sync_directory(aside)
        sync_directory(trials)
    known = {
        one["file"]
        for event in session.log.events
        if event.kind == "resumed"
        for one in event.content["abandoned"]
    }
    if not aside.is_dir():
        return []
    found = [path for path in sorted(aside.iterdir()) if f"{TRIALS}/{ABANDONED}/{path.name}" not in known]
    return [{"file": f"{TRIALS}/{ABANDONED}/{path.name}", "sha256": sha256_of(path)} for path in found]


def _find_damaged(session: Session) -> list[dict[str, str]]:
    events = [event for event in session.log.events if event.kind == "resumed"]
    known = {one["file"] for event in events for one in event.content.get("damaged", ())}
    found = [path for path in set_aside(session.log.path) if path.name not in known]
    return [{"file": path.name, "sha256": sha256_of(path)} for path in found]


def _free(directory: Path, path: Path) -> Path:
    for number in range(1, 10_000):
        found = directory / (path.name if number == 1 else f"{path.stem}-{number}{path.suffix}")
        if not found.exists():
            return found
    raise RecordingError(
        f"{directory} already contains 9999 files with the name {path.stem}",
        remedy="move some of these files to another directory",
    )
