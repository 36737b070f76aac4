"""Run or resume a participant's session from a protocol file, for `rig session run` and `rig session resume`.

All checks come before the first line of the log, so that a refused session leaves no trace.
"""

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig import config
from rig.config.schemes import Scheme
from rig.core import extras
from rig.core.errors import ConfigError, RecordingError
from rig.core.present import plain
from rig.core.regular_file import read_regular
from rig.recording.files import plain_errors
from rig.session.engine._arming import refuse_unarmable
from rig.session.engine._check import refuse_walls
from rig.session.engine._clock import SessionClock, WallClock
from rig.session.engine._conduct import Streams, conduct, first_wall
from rig.session.engine._desk import Desk, DeskView
from rig.session.engine._directory import (
    LOG,
    Session,
    begin,
    clear_rehearsal,
    refuse_begun,
    resume,
    study_directory,
)
from rig.session.engine._fitting import refuse_misfit
from rig.session.engine._log import Event, log_losses, read
from rig.session.engine._pace import refuse_lossy
from rig.session.engine._place import (
    Place,
    device_words,
    differences,
    last_opened,
    last_place,
    resume_command,
    software,
)
from rig.session.engine._protocol_changes import changed_keys, refuse_changed, walls_in
from rig.session.engine._rehearsal import Day, Person, RealDay, RehearsalDesk, check_person
from rig.session.engine._runner import TrialRunner
from rig.session.engine._state import SessionState
from rig.session.engine._telling import outcome
from rig.session.planning._conditions import ReachFor, Walls
from rig.session.planning._disk import refuse_full_disk
from rig.session.planning._load import load_walls
from rig.session.planning._names import normalise
from rig.session.planning._protocol import Protocol
from rig.session.planning._schedule import rows_of, schedule
from rig.session.planning._simulated_hand import reach_for

OnEvent = Callable[[Event], None]
# Arguments of the function: protocol, the study's experiment as nested dictionaries, and the rig.
DeskFor = Callable[[Protocol, Mapping[str, Any], TrialRunner], Desk]


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionResult:
    """Result of a session that has ended or was left; it contains nothing about the walls, which may be secret.

    Attributes
    ----------
    directory
        Directory of the participant.
    code, row
        Code of the participant, and the participant's row (from 0) in the table of condition orders.
    ended, stopped
        Reason for which the session ended, or for which the operator left it; otherwise None.
    trials, counted, invalid, by_machine, aborted, outside
        Numbers of recorded hits; of judged hits that count; of invalid hits, and of hits made invalid by computer or
        link; of hits cut off for safety; of hits outside the required ranges of impact speed and press.
    invalid_trials
        Sentence with the reasons for each invalid trial, oldest first, without hints at the wall.
    blocks, blocks_done
        Number of blocks without practice, and number of finished blocks.
    resume
        Command line that resumes the session; empty if the session has ended.
    messages
        Messages about permissions that this computer or the port did not grant, and about lost lines of the log.
    """

    directory: Path
    code: str
    row: int
    ended: str | None
    stopped: str | None
    trials: int
    counted: int
    invalid: int
    by_machine: int
    aborted: int
    outside: int
    blocks: int
    blocks_done: int
    resume: str = ""
    messages: tuple[str, ...] = ()
    invalid_trials: tuple[str, ...] = ()

    @property
    def stands(self) -> str:
        """Sentence about the state of the session, e.g. "session of P01: complete"."""
        why = self.ended or (f"interrupted: {self.stopped}" if self.stopped else "running")
        return f"session of {self.code}: {why}"

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Numbers of trials and blocks, and the directory, as pairs of label and text for display."""
        outside = f", {self.outside} outside the bands" if self.outside else ""
        trials = (
            f"{self.trials}, {self.counted} count, {self.invalid} invalid ({self.by_machine} by the machine), "
            f"{self.aborted} cut off{outside}"
        )
        return [
            ("trials", trials),
            ("blocks", f"{self.blocks_done} of {self.blocks} done"),
            ("directory", str(self.directory)),
        ]


def run_session(
    protocol_file: Path,
    code: str,
    desk: DeskFor,
    *,
    runner: TrialRunner,
    study: Path | None = None,
    row: int | None = None,
    person: Person | None = None,
    again: bool = False,
    other_protocol: bool = False,
    on_event: OnEvent | None = None,
    marks: str | None = None,
) -> SessionResult:
    """Run a participant's session from its beginning, and return the result.

    Parameters
    ----------
    protocol_file
        Protocol file in TOML (`rig.session.planning._protocol`).
    code
        Code of the participant.
    desk
        Function that creates the user interface, for a person or a simulated person.
    runner
        Object that runs trials on a rig; closed at the end.
    study
        Directory of all participants; by default a directory named after the study's title, in ``sessions/`` or, for a
        simulated person, in ``rehearsals/``.
    row
        The participant's row in the table of condition orders, from 0; by default the number in the code minus 1.
    person
        Simulated person, for a rehearsal of the session; None for a participant.
    again
        If True, delete an existing rehearsal of this code first.
    other_protocol
        Begin even if the protocol differs from that of the earlier sessions in a key that can affect a result.
    on_event
        Function that is called with each event after the event was written to the log.
    marks
        Name of the extra (`rig.core.extras`) that streams samples and events to other programs; without walls if a
        person must not know them.

    Raises
    ------
    ConfigError
        The protocol or the code is not valid, the participant has a session already, the protocol differs from that of
        the earlier sessions (`ChangedProtocolError`), or the rig refuses a wall (`rig.session.engine._arming`).
    RigError
        The session cannot continue: for example, the disk is full or the device is disconnected. The effort is zero.
    """
    code = normalise(code)
    walls = load_walls(protocol_file, _reach_for(runner))
    protocol, experiment = walls.protocol, walls.base
    with plain_errors("read", protocol_file):
        text = read_regular(protocol_file)
    place = study_directory(protocol, study, rehearsal=person is not None) / code
    changes = changed_keys(walls, place.parent, code)
    if not other_protocol:
        refuse_changed(changes, place.parent)
    if person is not None:
        check_person(person, protocol)
        if again:
            clear_rehearsal(place)
    refuse_begun(protocol, place, code)
    row = row_of(code) if row is None else _checked_row(row, protocol)
    _refuse_a_real_rig(person, runner)
    refuse_walls(walls)
    refuse_full_disk(walls, row, place)
    mapping = config.as_mapping(experiment)
    with closing(runner):
        # Before anything is written: a rig in use by another program, or a missing terminal, leaves no trace.
        runner.facts(*first_wall(walls, schedule(protocol, row)))
        refuse_misfit(walls, runner)
        refuse_unarmable(walls, runner)
        refuse_lossy(walls, runner)
        with (
            desk(protocol, mapping, runner) as operator,
            _streams(protocol, mapping, marks) as streams,
            begin(
                place,
                protocol,
                experiment,
                text=text,
                sha256=hashlib.sha256(text).hexdigest(),
                code=code,
                row=row,
                versions=software(),
                rehearsal=None if person is None else plain(person),
                differs=[one.key for one in changes],
                clock=_clock(person, runner),
            ) as session,
        ):
            return _conduct(session, runner, operator, walls, on_event, streams)


def compare_with_study(walls: Walls, code: str, study: Path | None, person: Person | None) -> None:
    """Raise `ChangedProtocolError` if the protocol differs from the study's earlier sessions so that results change.

    `code` is the participant, whose own session is not compared; with a `person` (simulated), compare rehearsals.
    """
    place = study_directory(walls.protocol, study, rehearsal=person is not None)
    refuse_changed(changed_keys(walls, place, normalise(code)), place)


def resume_session(
    directory: Path,
    desk: DeskFor,
    *,
    runner: TrialRunner,
    at: str = "trial",
    on_event: OnEvent | None = None,
    marks: str | None = None,
    other_device: bool = False,
) -> SessionResult:
    """Resume the session in a participant's directory, and return the result.

    `at` is "trial" to continue with the next trial, or "block" to repeat the current block. Raise `ConfigError`, before
    anything is written, if the device is not that of the session, unless `other_device` is set. The other parameters
    are those of `run_session`.
    """
    person = read_person(directory)
    _refuse_a_real_rig(person, runner)
    state, events = session_state(directory)
    with closing(runner):
        walls = walls_in(state, _reach_for(runner))
        if not other_device and state.ended is None:
            _refuse_another_device(state, events, runner, walls)
        refuse_unarmable(walls, runner)
        refuse_lossy(walls, runner)
        return _resume(directory, desk, state, person, runner, walls, at, on_event, marks)


def _refuse_another_device(
    state: SessionState, events: list[Event], runner: TrialRunner, walls: Walls
) -> None:
    before = last_opened(events)
    if not before:
        return
    now = runner.facts(*first_wall(walls, state.blocks))
    if differences(before, now):
        url = (before.get("place") or {}).get("url")
        raise ConfigError(
            f"the session of {state.code} began on {device_words(before)}, but this device is {device_words(now)}",
            remedy=f"give the URL of the first device{f', `url` {url}' if url else ' (omit it to simulate)'}; to "
            "continue on this device give `other_device`; the analysis will report the change",
        )


def _resume(
    directory: Path,
    desk: DeskFor,
    state: SessionState,
    person: Person | None,
    runner: TrialRunner,
    walls: Walls,
    at: str,
    on_event: OnEvent | None,
    marks: str | None,
) -> SessionResult:
    with (
        desk(state.protocol, state.experiment, runner) as operator,
        _streams(state.protocol, state.experiment, marks) as streams,
        resume(directory, at=at, clock=_clock(person, runner)) as session,
    ):
        return _conduct(session, runner, operator, walls, on_event, streams)


def read_person(directory: Path) -> Person | None:
    """Return the simulated person of the session in a directory; None if a real participant takes part."""
    events = read(directory / LOG)
    found = events[0].content.get("rehearsal") if events else None
    return None if found is None else Person(**found)


def took_place(directory: Path) -> Place:
    """Return the device on which the session in a directory was opened last."""
    return last_place(read(directory / LOG))


def rehearsal_desk(person: Person, looks: Callable[[DeskView], None] | None = None) -> DeskFor:
    """Return a function that creates the user interface of a simulated person.

    `looks` is called with each state of the session to display.
    """

    def desk(_: Protocol, __: Mapping[str, Any], runner: TrialRunner) -> Desk:
        return RehearsalDesk(person, Day() if runner.virtual else RealDay(), looks)

    return desk


def session_state(directory: Path) -> tuple[SessionState, list[Event]]:
    """Return the state and the events of the session in a directory, also while the session runs."""
    events = read(directory / LOG)
    return SessionState.of(events), events


def summary(
    directory: Path, state: SessionState, events: Sequence[Event] = (), messages: tuple[str, ...] = ()
) -> SessionResult:
    """Return the result of a session: numbers of trials and blocks, reason of the end, and `messages`."""
    counted = [trial for trial in state.trials if not (trial.void or trial.practice) and trial.verdict]
    blocks = [block for block in state.blocks if not block.practice]
    return SessionResult(
        directory=directory,
        code=state.code,
        row=state.row,
        ended=state.ended,
        stopped=state.stopped,
        trials=len(state.trials),
        counted=len(counted),
        invalid=sum(trial.invalid for trial in state.trials),
        by_machine=sum(trial.by_machine for trial in state.trials),
        aborted=sum(bool(trial.aborted) for trial in state.trials),
        outside=sum(bool(trial.outside) for trial in state.trials),
        blocks=len(blocks),
        blocks_done=sum(all(state.asks(run) is None for run in block.runs) for block in blocks),
        resume="" if state.ended is not None else resume_command(directory, events),
        messages=messages,
        invalid_trials=tuple(outcome(trial, blind=True) for trial in state.trials if trial.invalid),
    )


def row_of(code: str) -> int:
    """Return a participant's row (from 0) in the table of condition orders: the last number in the code minus 1.

    Raise `ConfigError` if the code contains no number, or if the last number is 0.
    """
    numbers = re.findall(r"[0-9]+", code)
    if not numbers:
        raise ConfigError(
            f"code {code!r} contains no number; the last number in a code selects the participant's row in the table "
            "of condition orders",
            remedy="give a code with a number, or give the row with `row`, counted from 0",
        )
    if int(numbers[-1]) == 0:
        raise ConfigError(
            f"code {code!r} has the number 0, but participants are counted from 1",
            remedy="give a code whose last number is 1 or more, or the row in the table of orders (from 0) with `row`",
        )
    return int(numbers[-1]) - 1


def _checked_row(row: int, protocol: Protocol) -> int:
    rows = max(protocol.study.participants, rows_of(protocol))
    if not 0 <= row < rows:
        raise ConfigError(
            f"the table of condition orders has no row {row}: {protocol.study.participants} participants are planned, "
            "and rows are counted from 0",
            remedy=f"give `row` 0 to {rows - 1}, or raise study.participants",
        )
    return row


def _reach_for(runner: TrialRunner) -> ReachFor | None:
    return reach_for if runner.simulated else None


def _refuse_a_real_rig(person: Person | None, runner: TrialRunner) -> None:
    if person is not None and not runner.simulated:
        raise ConfigError(
            "a rehearsal cannot use a real rig: the simulated person would continue after the operator stops it",
            remedy="omit `url`, or omit `rehearse` and run the session with a person",
        )


def _clock(person: Person | None, runner: TrialRunner) -> SessionClock:
    if person is None:
        return WallClock()
    return Day() if runner.virtual else RealDay()


def _conduct(
    session: Session,
    runner: TrialRunner,
    operator: Desk,
    walls: Walls,
    on_event: OnEvent | None,
    streams: Streams | None,
) -> SessionResult:
    try:
        conduct(session, runner, operator, walls=walls, on_event=on_event, marks=streams)
    finally:
        if streams is not None:
            sent = streams.close()
            with suppress(RecordingError):
                session.record("streamed", sent=sent, lost_markers=streams.lost)
    resumed = [event for event in session.log.events if event.kind == "resumed"][-1:]
    messages = [text for event in resumed for text in log_losses(event)] + list(runner.messages)
    return summary(session.directory, session.state, session.log.events, tuple(messages))


@contextmanager
def _streams(
    protocol: Protocol, experiment: Mapping[str, Any], marks: str | None
) -> Iterator[Streams | None]:
    """Yield the open data streams to other programs of the optional package `marks`; None if `marks` is None."""
    if marks is None:
        yield None
        return
    rates = {one.scheme and Scheme.parse(one.scheme).position_rate for one in protocol.condition}
    rate = rates.pop() if len(rates) == 1 else None
    opened: AbstractContextManager[Streams] = extras.load("marks", marks)(
        blind=protocol.study.blind != "none",
        # One rate known beforehand: then the stream of samples is there before the first trial.
        expected=(experiment["rig"]["motion"], float(rate)) if rate else None,
    )
    with opened as streams:
        streams.wait()
        yield streams
