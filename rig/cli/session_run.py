"""The commands ``rig session run``, ``resume``, ``show`` and ``amend``: run a participant's session.

`rig.session.conducting` runs it and writes its log; this file parses options and creates the operator's console.
"""

import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from rig.cli import options, output
from rig.cli._session_progress import Rehearsed
from rig.cli.command import DEVICE, command, option
from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.session import conducting
from rig.session.conducting import (
    LOG,
    ChangedProtocolError,
    DamagedLineError,
    Desk,
    DeskFor,
    DeviceRunner,
    Person,
    SessionResult,
    SessionState,
    TrialRunner,
    event_of_trial,
    last_opened,
    line_of_event,
    list_lost_samples,
    rehearsal_desk,
    session_state,
    set_damaged_line_aside,
    summary,
    whole_line,
)
from rig.session.conducting import amend as amend_event
from rig.session.protocols import load_walls

if sys.platform != "win32":
    from rig.session.terminal.desk import at_console

# Events before this time (s since 1970) are from a rehearsal, whose simulated time begins at 0.
_VIRTUAL_S = 1e8


_device_options = options.added(
    option(
        "--lossy-anyway",
        group=DEVICE,
        is_flag=True,
        help="Begin although this computer or the link is expected to make nearly every trial invalid.",
    ),
    option(
        "--hand",
        type=click.Choice(["simulated", "keyboard"]),
        default="simulated",
        show_default=True,
        help="What moves the handle of a simulated rig: its script, or keys (left, right: one step; "
        "down, up: five steps; home: back; end: into the wall). To move it with the mouse, use "
        "the page of `rig console`.",
    ),
    option(
        "--lsl", is_flag=True, help="Stream samples and markers by Lab Streaming Layer (haptic-rig[lsl])."
    ),
    options.url_option("the device in the log, else simulate the rig"),
    options.realtime_option("Run the rehearsal in real time."),
    options.verified_option,
    options.arm_anyway_option,
    options.json_option,
)
"""Settings of the session's rig and console."""
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
    help="Participant's row in the order of conditions, from 0. [the number in CODE minus one]",
)
@option(
    "--rehearse", group=_REHEARSAL, is_flag=True, help="Rehearse with a simulated person, in virtual time."
)
@option(
    "--threshold",
    "thresholds",
    group=_REHEARSAL,
    multiple=True,
    metavar="CONDITION=K",
    help="Stiffness at which half of the simulated person's verdicts are stable. [judges as the "
    "program does]",
)
@option("--spread", group=_REHEARSAL, type=float, help="How gradually verdicts change with stiffness. [15]")
@option("--lapse-rate", group=_REHEARSAL, type=float, help="Share of verdicts that are inverted. [0]")
@option(
    "--people-sd",
    group=_REHEARSAL,
    type=float,
    help="Spread of people about --threshold, which it needs: standard deviation of ln(threshold) over codes. [0]",
)
@option("--again", group=_REHEARSAL, is_flag=True, help="Delete the existing rehearsal and begin a new one.")
@click.option(
    "--other-protocol",
    is_flag=True,
    help="Begin although the protocol differs from the study's earlier sessions; the analysis then "
    "needs --across. [ask, on a terminal]",
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
    """Run the session of participant CODE as described in PROTOCOL.

    With --rehearse a simulated person hits and judges, and time is virtual. Without --url the rig is simulated: in real
    time, with the console, and the simulated hand or the keyboard moves the handle.

    Everything is stored below the study's directory, in one directory for each participant. Ctrl-C ends with zero
    effort; `rig session resume` continues the session.
    """
    given = {"spread": spread, "lapse_rate": lapse_rate, "people_sd": people_sd}
    known = {name: value for name, value in given.items() if value is not None}
    if not rehearse and (thresholds or realtime or again or known):
        raise ConfigError(
            "--threshold, --spread, --lapse-rate, --people-sd, --again and --realtime need "
            "--rehearse, which is not given",
            remedy="add --rehearse, or drop them (a session with a person always runs in real time)",
        )
    if rehearse and hand != "simulated":
        raise ConfigError(
            "--hand has no effect in a rehearsal",
            remedy="drop --hand: a simulated person moves the handle",
        )
    person = Person(thresholds=conducting.thresholds_of(thresholds), **known) if rehearse else None
    runner = _runner(url, realtime or not rehearse, verified, arm_anyway, lossy_anyway)
    other_protocol = other_protocol or _agrees_to_other_protocol(
        protocol, code, study, person, as_json=as_json
    )
    with Rehearsed(quiet=as_json or person is None) as seen:
        desk = _desk(person, seen, hand=hand)
        result = conducting.run_session(
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
    help="Continue on another device than before; the analysis reports the change.",
)
@click.option(
    "--drop-damaged-line",
    is_flag=True,
    help="First move a damaged last line of the log to a file beside it.",
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
    """Resume the session in DIRECTORY after any end: Ctrl-C, kill -9, a power cut, an unplugged rig.

    Without --url the session continues on the device in its log. A real rig needs --verified again: the signs of motor
    and encoder are checked, and the handle is at position zero.
    """
    if drop_damaged_line and (directory / LOG).is_file():
        kept = set_damaged_line_aside(directory / LOG)
        found = "no line is damaged" if kept is None else f"the damaged line was moved to {kept}"
        click.echo(f"rig: {found}", err=True)
    person, place = conducting.read_person(directory), conducting.took_place(directory)
    runner = _runner(
        url or place.url, realtime or place.realtime or person is None, verified, arm_anyway, lossy_anyway
    )
    with Rehearsed(quiet=as_json or person is None) as seen:
        desk = _desk(person, seen, hand=hand)
        result = conducting.resume_session(
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
    "--unblind", is_flag=True, help="Also show conditions and walls; --json prints the records themselves."
)
@options.json_option
def show(directory: Path, with_log: bool, unblind: bool, as_json: bool) -> None:
    """Show the progress of the session in DIRECTORY, also while it runs."""
    damage = None
    try:
        state, events = session_state(directory)
    except DamagedLineError as error:
        # A damaged log still shows the events before the damage: the operator needs them to decide on a repair.
        if not error.events:
            raise
        damage, events = error, list(error.events)
        state = SessionState.of(events)
    result = summary(directory, state, events, tuple(list_lost_samples(last_opened(events))))
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
    """Return date and local time of day of an event at `at_s` (s since 1970), as two texts.

    For an event in simulated time, which begins at 0, return the time since the start instead.
    """
    if at_s < _VIRTUAL_S:
        whole = int(at_s)
        return "in the simulation's time", f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}"
    when = datetime.fromtimestamp(at_s).astimezone()
    return f"{when:%Y-%m-%d, UTC%z}", f"{when:%H:%M:%S}"


@command()
@click.argument("directory", type=click.Path(path_type=Path))
@click.argument("words", nargs=-1, required=True, metavar="[EVENT] VALUE")
@click.option("--trial", type=int, help="Correct this trial instead of EVENT.")
@click.option("--why", required=True, help="Reason for the correction; it is stored with it.")
@options.json_option
def amend(directory: Path, words: tuple[str, ...], trial: int | None, why: str, as_json: bool) -> None:
    """Correct the log in DIRECTORY: the verdict of a trial, whether a trial counts, a note, an answer.

    With --trial N, VALUE is another verdict; or void, so that the trial does not count; or counts, to undo void. Else
    EVENT is the number of the log entry to correct (`rig session show --log`). Nothing is erased: the
    correction is a separate event.
    """
    value = words[-1]
    numbers = [int(text) for text in words[:-1] if text.isdecimal()]
    if len(words) != (2 if trial is None else 1) or len(numbers) != len(words) - 1:
        raise ConfigError(
            f"{' '.join(words)!r} is not a correction: expected an event's number and its new value",
            remedy="give --trial N VALUE, or EVENT VALUE, with VALUE in quotes",
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
    """Return True if the protocol differs from the study's earlier sessions and the operator agrees to use it."""
    if as_json or not _is_interactive():
        return False
    try:
        conducting.compare_with_study(load_walls(protocol), code, study, person)
    except ChangedProtocolError as error:
        click.echo(f"rig: {output.for_terminal(error.message)}", err=True)
        return click.confirm("Begin anyway? The analysis then needs --across.", err=True)
    return False


def _is_interactive() -> bool:
    return sys.stdin.isatty()


def _desk(person: Person | None, seen: Rehearsed, *, hand: str) -> DeskFor:
    return _console(hand) if person is None else rehearsal_desk(person, looks=seen.looks)


def _runner(
    url: str | None, realtime: bool, verified: bool, arm_anyway: bool, lossy_anyway: bool
) -> TrialRunner:
    return DeviceRunner(
        url=url, realtime=realtime, verified=verified, arm_anyway=arm_anyway, lossy_anyway=lossy_anyway
    )


def _console(hand: str) -> DeskFor:
    """Return a function that creates the operator's console, or raises `ConfigError` where terminals are missing."""

    def desk(*about: Any) -> Desk:  # made when the session begins: an invalid code is reported first
        if sys.platform == "win32":
            raise ConfigError(
                "a session at a terminal needs Linux or macOS, and this system is neither",
                remedy="rehearse with --rehearse, or run the session on Linux or macOS",
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
