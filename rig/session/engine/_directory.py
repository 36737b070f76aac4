"""The directory of one participant: how a session begins, is resumed after whatever ended it, and is corrected.

session.log               every decision (`rig.session.engine._log`); nothing else is remembered
protocol.toml             the protocol file as it was
trials/t0001.parquet …    recordings; the name has the trial's number and nothing of its wall
trials/abandoned/         recordings of trials that were not logged, because the process died
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

OF_TRIAL = {"void": True, "counts": False}  # what an amendment may change of a trial itself
WALL = WallClock()
SESSIONS, REHEARSALS = Path("sessions"), Path("rehearsals")
LOG, PROTOCOL, TRIALS, ABANDONED = "session.log", "protocol.toml", "trials", "abandoned"


@dataclass(kw_only=True)
class Session:
    """The open directory of one participant; one process at a time.

    Attributes
    ----------
    directory
        Of the participant.
    log, state
        The decisions so far, and where they lead.
    clock
        What the log's times are taken from.
    """

    directory: Path
    log: SessionLog
    state: SessionState
    clock: SessionClock = field(default_factory=WallClock)

    def record(self, kind: str, **content: Any) -> Event:
        """Write an event to the log, and only then apply it to the state."""
        event = self.log.append(kind, **content)
        self.state.apply(event)
        return event

    def close(self) -> None:
        """Close the log and release the directory for other programs."""
        self.log.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def study_directory(protocol: Protocol, study: Path | None, *, rehearsal: bool = False) -> Path:
    """Return where the participants of a protocol are kept, or those who were simulated."""
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
    """Begin a participant's session in a directory of its own.

    Parameters
    ----------
    directory
        Made when it is not there.
    protocol, experiment
        What is done, and on which rig (`rig.session.planning._conditions.base_of`).
    text, sha256
        The protocol file as it is, of which a copy is kept.
    code, row
        Of the participant; the row decides the order.
    versions, rehearsal, differs
        What goes into the log with it; `differs`: keys in which the study's earlier sessions have another value.
    clock
        Time of day (s).

    Raises
    ------
    ConfigError
        The code is not valid, or the participant has a session already: nothing is overwritten.
    RecordingError
        Another process has the session open, or the disk refuses.
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
    """Raise `ConfigError` for an invalid code, or a directory that holds a session already."""
    check_code(protocol, code)
    if (directory / LOG).exists() and (events := read(directory / LOG)):
        raise _begun(directory, events)


def clear_rehearsal(directory: Path) -> None:
    """Delete a rehearsal, which can be repeated; leave a person's session, or any other directory, as it is."""
    events = read(directory / LOG) if (directory / LOG).exists() else []
    if events and events[0].content.get("rehearsal") is not None:
        shutil.rmtree(directory)


def _begun(directory: Path, events: Sequence[Event]) -> ConfigError:
    rehearsal = events[0].content.get("rehearsal") is not None
    return ConfigError(
        f"{directory} already contains a {'rehearsal with a simulated person' if rehearsal else 'session'} "
        f"({len(events)} events)",
        remedy=f"resume it: {resume_command(directory, events)}; or give another "
        + ("code, or another directory for people with `study`" if rehearsal else "code"),
    )


def resume(directory: Path, *, at: str = "trial", clock: SessionClock = WALL) -> Session:
    """Resume a session, whatever ended it.

    Recordings of trials that were not logged are moved aside, hashed, and named in the log.

    Parameters
    ----------
    directory
        Of the participant.
    at
        "trial": with the next one; "block": the block that was begun starts over, its trials count no more.
    clock
        Time of day (s).

    Raises
    ------
    ConfigError
        There is nothing to resume.
    RecordingError
        Another process has it open, the log is damaged, or the disk refuses.
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
                f"{directory} is not the directory of a session: it contains no {LOG}",
                remedy="give the directory of one participant",
            )


def event_of_trial(directory: Path, trial: int, value: str) -> int:
    """Number of the event that an amendment of a trial is about: its verdict, or with `OF_TRIAL` the trial itself.

    Raises `ConfigError` if the session has no such event.
    """
    _refuse_no_session(directory)
    kind = "trial" if value in OF_TRIAL else "judged"
    events = [
        event for event in read(directory / LOG) if event.kind == kind and event.content["trial"] == trial
    ]
    if not events:
        raise ConfigError(
            f"{directory} has no trial {trial}" if kind == "trial" else f"trial {trial} has no verdict",
            remedy="list them with rig session show --log",
        )
    return events[-1].number


def amend(
    directory: Path, number: int, value: str, why: str, *, clock: Callable[[], float] = time.time
) -> Event:
    """Record a correction of an event; nothing is erased, and the state is what the corrected events give.

    A verdict, the text of a note and an answer can be corrected; a trial can be excluded ("void"), or included again
    ("counts").

    Raises
    ------
    ConfigError
        No such event, one that cannot be corrected, no such verdict, or no reason.
    RecordingError
        As `resume`.
    """
    _refuse_no_session(directory)
    with SessionLog(directory / LOG, clock=clock) as log:
        if not 0 <= number < len(log.events):
            raise ConfigError(
                f"{directory} has no event {number}: its log has 0 to {len(log.events) - 1}",
                remedy="list them with rig session show",
            )
        kind = log.events[number].kind
        if kind not in AMENDABLE:
            raise ConfigError(
                f"event {number} is {kind!r}, which cannot be corrected",
                remedy=f"correct one of {', '.join(AMENDABLE)}; write anything else into a note",
            )
        (name,) = AMENDABLE[kind]
        if name == "verdict" and value not in VERDICTS:
            raise ConfigError(f"{value!r} is not a verdict", remedy=f"choose one of {', '.join(VERDICTS)}")
        if not why.strip():
            raise ConfigError("a correction needs a reason", remedy="give it with `why`")
        if name == "void" and value not in OF_TRIAL:
            raise ConfigError(
                f"event {number} is a trial, which cannot be corrected to {value!r}",
                remedy=f"choose one of {', '.join(OF_TRIAL)}; to correct its verdict, give `trial` N",
            )
        kept: str | int | bool = OF_TRIAL.get(value, value) if name == "void" else value
        if kind == "answered":
            kept = _corrected_answer(SessionState.of(log.events), log.events[number].content["item"], value)
        trial = log.events[number].content.get("trial")
        about = {} if not trial else {"trial": trial}
        return log.append("amended", number=number, field=name, value=kept, why=why, **about)


def _corrected_answer(state: SessionState, name: str, value: str) -> str | int:
    """Return an answer as the protocol wants it; raise `ConfigError` if it is not valid."""
    item = next((one for one in state.protocol.question if one.name == name), None)
    if item is None:
        return value
    kept = parse_answer(describe_item(item), value)
    if kept is None:
        raise ConfigError(
            f"{value!r} is not an answer to {name}", remedy=f"give {describe_answer(describe_item(item))}"
        )
    return kept


def _set_aside(session: Session) -> list[dict[str, str]]:
    """Move away recordings that no event names, and list those that no earlier event listed."""
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
    """Return lines that were taken out of the log, and that no earlier event names."""
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
        f"{directory} contains too many recordings named {path.stem}", remedy="move some of them away"
    )
