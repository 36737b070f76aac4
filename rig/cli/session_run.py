"""``rig session run``, ``resume``, ``show`` and ``amend``."""

from __future__ import annotations

import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from rig.cli import options, output
from rig.cli.command import DEVICE, command, option
from rig.cli.session_progress import Rehearsed
from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.session.engine import rehearsal
from rig.session.engine import run as sessions
from rig.session.engine.desk import Desk
from rig.session.engine.directory import LOG, event_of_trial
from rig.session.engine.directory import amend as amend_event
from rig.session.engine.hits import DeviceRunner
from rig.session.engine.log import DamagedLineError, set_damaged_line_aside
from rig.session.engine.place import last_opened
from rig.session.engine.protocol_changes import ChangedProtocolError
from rig.session.engine.rehearsal import Person
from rig.session.engine.run import DeskFor, SessionResult, rehearsal_desk, session_state, summary
from rig.session.engine.runner import TrialRunner
from rig.session.engine.state import SessionState
from rig.session.engine.telling import line_of_event, lost_samples, whole_line
from rig.session.planning.load import load_walls

if sys.platform != "win32":
    from rig.session.terminal.desk import at_console

_VIRTUAL_S = 1e8  # since 1970: no participant sat then


_device_options = options.added(
    option(
        "--lossy-anyway",
        group=DEVICE,
        is_flag=True,
        help="Begin although this computer or the link spoils nearly every trial.",
    ),
    option(
        "--hand",
        type=click.Choice(["simulated", "keyboard"]),
        default="simulated",
        show_default=True,
        help="Who moves the handle of a simulated rig: its script, or keys (left, right: a step; down, up: five; home: "
        "back; end: into the wall). The mouse moves it on a page: `rig console`.",
    ),
    option(
        "--lsl", is_flag=True, help="Stream samples and markers by Lab Streaming Layer (haptic-rig[lsl])."
    ),
    options.url_option("as the log says, or simulates the rig"),
    options.realtime_option("A rehearsal in real time."),
    options.verified_option,
    options.arm_anyway_option,
    options.json_option,
)
"""Of a session's rig and console."""
_REHEARSAL = "Rehearsal"


@command(quiet=False)
@click.argument("protocol", type=click.Path(path_type=Path))
@click.argument("code")
@click.option(
    "--study",
    type=click.Path(path_type=Path),
    help="Directory of all participants. [sessions/TITLE, or rehearsals/TITLE]",
)
@click.option(
    "--row",
    type=click.IntRange(min=0),
    help="Participant's row of the order, from 0. [the number in CODE, less one]",
)
@option("--rehearse", group=_REHEARSAL, is_flag=True, help="With a simulated person, in virtual time.")
@option(
    "--threshold",
    "thresholds",
    group=_REHEARSAL,
    multiple=True,
    metavar="CONDITION=K",
    help="Where half of this person's verdicts are stable. [judges as the program does]",
)
@option("--spread", group=_REHEARSAL, type=float, help="How gradually verdicts change over stiffness. [15]")
@option("--lapse-rate", group=_REHEARSAL, type=float, help="Share of verdicts that are turned round. [0]")
@option(
    "--people-sd",
    group=_REHEARSAL,
    type=float,
    help="Spread of people about --threshold, which it needs: standard deviation of ln(threshold) over codes. [0]",
)
@option("--again", group=_REHEARSAL, is_flag=True, help="Delete the one that is there and begin anew.")
@click.option(
    "--other-protocol",
    is_flag=True,
    help="Begin although the protocol is not that of the study's earlier sessions; the analysis then needs --across. "
    "[a terminal asks]",
)
@_device_options
def run(
    protocol: Path,
    code: str,
    study: Path | None,
    row: int | None,
    rehearse: bool,
    thresholds: tuple[str, ...],
    spread: float | None,
    lapse_rate: float | None,
    people_sd: float | None,
    again: bool,
    other_protocol: bool,
    url: str | None,
    realtime: bool,
    verified: bool,
    arm_anyway: bool,
    lossy_anyway: bool,
    hand: str,
    lsl: bool,
    as_json: bool,
) -> None:
    """Run the session of participant CODE as PROTOCOL says.

    With --rehearse a simulated person hits and judges, and time is virtual. Without --url the rig is simulated: in real
    time, with the console, and the simulated hand or the keyboard moves the handle.

    Everything is kept below the study's directory, one directory a participant. Ctrl-C ends with zero effort; `rig
    session resume` continues it.
    """
    given = {"spread": spread, "lapse_rate": lapse_rate, "people_sd": people_sd}
    known = {name: value for name, value in given.items() if value is not None}
    if not rehearse and (thresholds or realtime or again or known):
        raise ConfigError(
            "--threshold, --spread, --lapse-rate, --people-sd, --again and --realtime belong to a rehearsal",
            remedy="add --rehearse; a person's session is in real time as it is",
        )
    if rehearse and hand != "simulated":
        raise ConfigError(
            "--hand belongs to a session with a person",
            remedy="leave it out; a rehearsal has no console",
        )
    person = rehearsal.Person(thresholds=rehearsal.thresholds_of(thresholds), **known) if rehearse else None
    runner = _runner(url, realtime or not rehearse, verified, arm_anyway, lossy_anyway)
    other_protocol = other_protocol or _agrees_to_other_protocol(
        protocol, code, study, person, as_json=as_json
    )
    with Rehearsed(quiet=as_json or person is None) as seen:
        desk = _desk(person, seen, hand=hand)
        result = sessions.run_session(
            protocol,
            code,
            desk,
            runner=runner,
            study=study,
            row=row,
            person=person,
            again=again,
            other_protocol=other_protocol,
            on_event=seen.on_event,
            marks="lsl" if lsl else None,
        )
    _print(result, as_json=as_json)


@command(quiet=False)
@click.argument("directory", type=click.Path(path_type=Path))
@click.option(
    "--at",
    type=click.Choice(["trial", "block"]),
    default="trial",
    show_default=True,
    help="Continue with the next trial, or restart the block.",
)
@click.option(
    "--other-device",
    is_flag=True,
    help="Continue on another device than before; the analysis reports it.",
)
@click.option(
    "--drop-damaged-line",
    is_flag=True,
    help="Set a damaged last line of the log aside first; its bytes are kept beside it.",
)
@_device_options
def resume(
    directory: Path,
    at: str,
    other_device: bool,
    drop_damaged_line: bool,
    url: str | None,
    realtime: bool,
    verified: bool,
    arm_anyway: bool,
    lossy_anyway: bool,
    hand: str,
    lsl: bool,
    as_json: bool,
) -> None:
    """Resume the session in DIRECTORY, whatever ended it: Ctrl-C, kill -9, a power cut, an unplugged rig.

    It resumes where it took place: without --url on the device of the log. A real rig needs --verified again: somebody
    has looked at its signs, and the handle is at zero.
    """
    if drop_damaged_line and (directory / LOG).is_file():
        kept = set_damaged_line_aside(directory / LOG)
        found = "no line is damaged" if kept is None else f"the damaged line is in {kept} now"
        click.echo(f"rig: {found}", err=True)
    person, place = sessions.rehearsed(directory), sessions.took_place(directory)
    runner = _runner(
        url or place.url, realtime or place.realtime or person is None, verified, arm_anyway, lossy_anyway
    )
    with Rehearsed(quiet=as_json or person is None) as seen:
        desk = _desk(person, seen, hand=hand)
        result = sessions.resume_session(
            directory,
            desk,
            runner=runner,
            at=at,
            on_event=seen.on_event,
            marks="lsl" if lsl else None,
            other_device=other_device,
        )
    _print(result, as_json=as_json)


@command()
@click.argument("directory", type=click.Path(path_type=Path))
@click.option("--log", "with_log", is_flag=True, help="List the events, numbered.")
@click.option(
    "--unblind", is_flag=True, help="Show conditions and walls too; the records themselves with --json."
)
@options.json_option
def show(directory: Path, with_log: bool, unblind: bool, as_json: bool) -> None:
    """Say where the session in DIRECTORY stands; also while it runs."""
    damage = None
    try:
        state, events = session_state(directory)
    except DamagedLineError as error:
        if not error.events:
            raise
        damage, events = error, list(error.events)
        state = SessionState.of(events)
    result = summary(directory, state, events, tuple(lost_samples(last_opened(events))))
    if as_json:
        listed = [
            {
                "number": event.number,
                "at": event.at,
                "kind": event.kind,
                **({"content": dict(event.content)} if unblind else {"text": line_of_event(event)}),
            }
            for event in events
        ]
        output.print_json({**plain(result), "events": listed})
    else:
        _print(result, as_json=False)
    if with_log and not as_json:
        date, motion = "", state.experiment["rig"]["motion"]
        for event in events:
            day, when = _when(event.at)
            if day != date:
                date = day
                click.echo(f"  {day}")
            text = whole_line(event, motion) if unblind else line_of_event(event)
            click.echo(f"  {event.number:>5}  {when}  {event.kind:<9} {text}")
    if damage is not None:
        raise damage


def _when(at_s: float) -> tuple[str, str]:
    """Date and time of day here; in virtual time, which begins at 0, the time since then."""
    if at_s < _VIRTUAL_S:
        whole = int(at_s)
        return "in the simulation's time", f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}"
    when = datetime.fromtimestamp(at_s).astimezone()
    return f"{when:%Y-%m-%d, UTC%z}", f"{when:%H:%M:%S}"


@command()
@click.argument("directory", type=click.Path(path_type=Path))
@click.argument("said", nargs=-1, required=True, metavar="[EVENT] VALUE")
@click.option("--trial", type=int, help="Correct this trial instead of EVENT.")
@click.option("--why", required=True, help="Reason for the correction, kept with it.")
@options.json_option
def amend(directory: Path, said: tuple[str, ...], trial: int | None, why: str, as_json: bool) -> None:
    """Correct the log in DIRECTORY: the verdict of a trial, whether a trial counts, a note, an answer.

    With --trial N, VALUE is another verdict, or void: the trial does not count (counts takes that back). EVENT is a
    number of `rig session show --log`. Nothing is erased: the correction is an event of its own.
    """
    value = said[-1]
    numbers = [int(text) for text in said[:-1] if text.isdecimal()]
    if len(said) != (2 if trial is None else 1) or len(numbers) != len(said) - 1:
        raise ConfigError(
            f"{' '.join(said)!r} is no correction",
            remedy="give --trial N VALUE, or EVENT VALUE: an event's number and what it reads instead, in quotes",
        )
    event = numbers[0] if trial is None else event_of_trial(directory, trial, value)
    written = amend_event(directory, event, value, why)
    if as_json:
        output.print_json({"number": written.number, "corrects": event, "value": value, "why": why})
    else:
        about = f"event {event}" if trial is None else f"trial {trial}"
        click.echo(f"{about} now reads {value!r}, by event {written.number}")


def _agrees_to_other_protocol(
    protocol: Path, code: str, study: Path | None, person: Person | None, *, as_json: bool
) -> bool:
    """Ask at a terminal about a protocol that is not that of the earlier sessions; elsewhere the session refuses it."""
    if as_json or not _is_interactive():
        return False
    try:
        sessions.compare_with_study(load_walls(protocol), code, study, person)
    except ChangedProtocolError as error:
        click.echo(f"rig: {output.for_terminal(error.message)}", err=True)
        return click.confirm("Begin all the same? The analysis then needs --across.", err=True)
    return False


def _is_interactive() -> bool:
    return sys.stdin.isatty()


def _desk(person: Person | None, seen: Rehearsed, *, hand: str) -> DeskFor:
    """The console, or the simulated person whose progress is shown."""
    return _console(hand) if person is None else rehearsal_desk(person, looks=seen.looks)


def _runner(
    url: str | None, realtime: bool, verified: bool, arm_anyway: bool, lossy_anyway: bool
) -> TrialRunner:
    return DeviceRunner(
        url=url, realtime=realtime, verified=verified, arm_anyway=arm_anyway, lossy_anyway=lossy_anyway
    )


def _console(hand: str) -> DeskFor:
    """Return what makes the desk at the operator's terminal; refuses a process without a terminal."""

    def desk(*about: Any) -> Desk:  # only when somebody may sit there: what is wrong with a code comes first
        if sys.platform == "win32":
            raise ConfigError(
                "a session at a terminal needs Linux or macOS", remedy="rehearse it: --rehearse"
            )
        else:
            return at_console(hand="keyboard" if hand == "keyboard" else None)(*about)

    return desk


def _print(result: SessionResult, *, as_json: bool) -> None:
    if as_json:
        output.print_json(result)
        return
    for message in result.messages:
        click.echo(f"rig: {message}", err=True)
    click.echo(result.stands)
    output.print_pairs(result.pairs)
    if result.ended is None:
        click.echo(f"  resume it with: {result.resume}")
