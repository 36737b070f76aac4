"""The commands ``rig session new``, ``check`` and ``schema``: write and check the protocol of a study.

`rig.session.protocols` checks; this file parses options and prints. It must not show the order to a blinded operator.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import click
from rich import box
from rich.console import Console
from rich.table import Table

from rig.cli import options, output
from rig.cli.command import command
from rig.core.errors import PlanError
from rig.core.present import plain
from rig.core.sample import unit_of
from rig.session import protocols
from rig.session.protocols import (
    CellPlan,
    ExpectedRange,
    StudyPlan,
    format_size,
    json_schema,
    load_protocol,
    study_directory,
)

_MARKS = {"ok": ("ok", "green"), "warning": ("!!", "yellow"), "refused": ("no", "red")}
# Named as a text, because importing it imports the loop, which a check without --url does not need.
DEVICE_CHECKS = "rig.session.conducting:device_checks"
# Participants whose order is printed; --json has the order of all.
MOST_ORDERS = 24


@command()
@click.argument("file", required=False, type=click.Path(path_type=Path))
@click.option("--template", metavar="NAME", help="Template; --list lists them. [first-steps]")
@click.option("--list", "listed", is_flag=True, help="List the templates, and write nothing.")
@options.json_option
def new(file: Path | None, template: str | None, listed: bool, as_json: bool) -> None:
    """Write a commented protocol into FILE, named after its template if not given. Nothing is overwritten.

    The JSON schema, by which editors complete and check the protocol (taplo, Even Better TOML in VS Code), is written
    into the same directory.
    """
    if listed:
        subjects = {name: protocols.template_subject(name) for name in protocols.template_names()}
        if as_json:
            output.print_json(subjects)
        else:
            output.print_pairs(list(subjects.items()))
        return
    name = template or protocols.DEFAULT
    path = file or Path(f"{name}.toml")
    beside = protocols.write_template(name, path)
    if as_json:
        output.print_json(
            {"file": str(path), "template": name, "schema": None if beside is None else str(beside)}
        )
        return
    click.echo(f"{path}: {protocols.template_subject(name)}")
    click.echo(f"  for editors: {beside or f'{protocols.SCHEMA} (it existed and is unchanged)'}")
    click.echo(f"  check the planned session: rig session check {path}")


@command()
@options.json_option
def schema(as_json: bool) -> None:
    """Print the JSON schema of protocol files, for editors that complete and check TOML (taplo, VS Code)."""
    output.print_json(json_schema())


@command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--participants",
    type=click.IntRange(1, 10_000),
    help="Number of participants. [as in FILE]",
)
@click.option(
    "--study",
    type=click.Path(path_type=Path),
    help="Directory of the participants; durations are estimated from their finished sessions. "
    "[sessions/TITLE]",
)
@options.url_option("without: the rate and link of a device are not checked")
@click.option(
    "--unblind",
    is_flag=True,
    help="Show the order of the searches although the operator is blinded; only for people who never "
    "operate a session.",
)
@options.json_option
def check(
    file: Path, participants: int | None, study: Path | None, url: str | None, unblind: bool, as_json: bool
) -> None:
    """Show what the protocol FILE will do, and check it; nothing moves.

    Shows trials, time, heat of the motor, the order of each participant and who sees what, and compares every wall that
    a search rule may reach with the limits of the rig and with linear theory. If the operator is blinded, the order is
    left out, so that the operator may run this command too.

    Exits with an error if a check refuses the protocol.
    """
    protocol = load_protocol(file)
    plan = protocols.check(
        protocol,
        file.parent,
        participants=participants,
        of_device=partial(resolve_name(DEVICE_CHECKS), url) if url is not None else None,
        study=study_directory(protocol, study),
    )
    if as_json:
        shown = plain(plan)
        if plan.blinded and not unblind:
            shown["orders"] = None
        output.print_json(shown)
    else:
        _print(plan, unblind=unblind)
    if not plan.ok:
        refused = [one.name for one in plan.checks if one.outcome == "refused"]
        raise PlanError(
            f"the protocol is refused by the checks {', '.join(refused)}",
            remedy="follow the remedy of each of these checks",
        )


def _print(plan: StudyPlan, *, unblind: bool) -> None:
    who = "the participant hits" if plan.kind == "human" else "the motor hits"
    click.echo(f"{plan.title}: on {plan.rig}, {who}; {plan.participants} participants")
    practice = f", {plan.practice} of practice" if plan.practice else ""
    output.print_pairs(
        [
            ("session", f"{plan.runs} searches in {plan.blocks} blocks"),
            ("trials", f"{_number(plan.trials)}{practice}; repeated trials are added"),
            ("time", f"{_minutes(plan.session_s)} min"),
            *((f"  {name}", f"{_minutes(part)} min") for name, part in plan.duration_s.items()),
            ("one trial", _trial(plan)),
            *_measured_times(plan),
            (
                "on disk",
                f"{format_size(plan.trial_bytes)} a trial, {format_size(plan.disk_bytes.likely)} a participant",
            ),
            ("a rehearsal", f"about {_minutes(plan.rehearsal_s)} min of computing"),
            *(("hidden from", who) for who in plan.hidden),
        ]
    )
    _print_cells(plan)
    if plan.blinded and not unblind:
        click.echo(
            "\nThe order of the searches is not shown: the operator is blinded, and it would reveal "
            "the condition of each wall. The person who plans the study and never operates a session "
            "can show it with --unblind."
        )
    else:
        _print_orders(plan)
    for one in plan.checks:
        mark, colour = _MARKS[one.outcome]
        remedy = "" if one.outcome == "ok" or not one.remedy else f": {one.remedy}"
        click.echo(f"  {click.style(mark, fg=colour)} {one.name}: {output.for_terminal(one.text + remedy)}")


def _print_cells(plan: StudyPlan) -> None:
    stiffness, damping = unit_of("stiffness", plan.motion), unit_of("damping", plan.motion)
    table = _table(
        f"Searches: K in {stiffness}, B in {damping}. By linear theory, without friction and encoder: "
        "the largest stable K of a free handle and of one in a hand; in brackets the number of "
        "levels above it",
        left=("condition", "rule"),
        right=("B", "levels", "free", "in hand", "limit expected", "trials"),
    )
    for cell in plan.cells:
        table.add_row(*_cell(cell))
    notes = {f"{cell.condition}: {cell.expected.note}" for cell in plan.cells if cell.expected.note}
    notes |= {f"{cell.condition}: fit {cell.fit} (not in the time above)" for cell in plan.cells if cell.fit}
    _show(table)
    for note in sorted(notes):
        click.echo(f"  {note}")


def _cell(cell: CellPlan) -> list[str]:
    expected, levels = cell.expected, cell.levels
    held = expected.in_hand
    limit = expected.limit
    return [
        cell.condition,
        cell.rule,
        f"{cell.damping:g}",
        f"{levels[0]:.4g} … {levels[-1]:.4g} ({len(levels)})",
        "?" if expected.free is None else f"{expected.free:.4g} ({len(cell.unstable_free or ())})",
        "?" if held is None else f"{held[0]:.4g} … {held[1]:.4g} ({len(cell.unstable_in_hand or ())})",
        f"{limit.least:.4g} … {limit.most:.4g}",
        _number(cell.trials.count),
    ]


def _print_orders(plan: StudyPlan) -> None:
    shown = plan.orders[:MOST_ORDERS]
    names = list(dict.fromkeys(name for order in shown for block in order for name in block))
    letters = {name: _letters(place) for place, name in enumerate(names)}
    table = _table("Order of the searches, block by block", left=("participant", "blocks"), right=())
    for number, order in enumerate(shown, 1):
        table.add_row(str(number), "   ".join(" ".join(letters[name] for name in block) for block in order))
    _show(table)
    for name, letter in letters.items():
        click.echo(f"  {letter}: {name}")
    if len(plan.orders) > len(shown):
        click.echo(f"  … and {len(plan.orders) - len(shown)} more: --json has all")


def _letters(place: int) -> str:
    return chr(ord("A") + place % 26) + (str(place // 26) if place >= 26 else "")


def _table(title: str, left: tuple[str, ...], right: tuple[str, ...]) -> Any:
    click.echo(f"\n{title}")
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in left:
        table.add_column(name)
    for name in right:
        table.add_column(name, justify="right")
    return table


def _show(table: Any) -> None:
    console = Console()
    if not console.is_terminal:  # a file or a pipe has no width: nothing is folded
        console = Console(width=200)
    console.print(table)


def _trial(plan: StudyPlan) -> str:
    one = plan.trial
    return (
        f"{one.total:.1f} s: ready {one.ready:g}, homing {one.homing:.2g}, free space {one.baseline:g}, "
        f"hit {one.hit + one.release:.2g}, verdict {one.verdict:g}"
    )


def _measured_times(plan: StudyPlan) -> Iterator[tuple[str, str]]:
    if plan.taken is not None:
        sessions = f"{plan.taken.sessions} finished session{'s' if plan.taken.sessions > 1 else ''}"
        yield (
            "times of people",
            f"medians of {plan.taken.trials} trials in {sessions}, instead of the times in the protocol",
        )


def _number(expected: ExpectedRange) -> str:
    if round(expected.least) == round(expected.most):
        return f"{expected.likely:.0f}"
    return f"{expected.likely:.0f} ({expected.least:.0f} … {expected.most:.0f})"


def _minutes(seconds: ExpectedRange) -> str:
    low, likely, high = (value / 60.0 for value in seconds.values)
    if high - low < 0.05 * high:
        return _two_digits(likely)
    return f"{_two_digits(likely)} ({_two_digits(low)} … {_two_digits(high)})"


def _two_digits(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"
