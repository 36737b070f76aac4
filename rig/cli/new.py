"""The command ``rig experiment new``: write an experiment file from data sheets.

`rig.experiments.new_rig` has the questions and converts the answers; this file asks them and writes the file.
"""

import sys
from collections.abc import Callable
from functools import reduce
from pathlib import Path
from typing import Any

import click

from rig import NewRig, new_rig
from rig.cli import options, output
from rig.cli._next_step import name_next
from rig.cli.command import command, option
from rig.core.errors import ConfigError
from rig.core.present import Row
from rig.experiments.new_rig import DataSheetQuestion, questions, questions_for


def _answer_options(function: options.F) -> options.F:
    return reduce(
        lambda decorated, add: add(decorated),
        reversed([_option(*one) for one in questions().items()]),
        function,
    )


def _option(name: str, question: DataSheetQuestion) -> Callable[[options.F], options.F]:
    more = f" [{question.assumed}]" if question.assumed else ""
    allowed = f", {'|'.join(question.choices)}" if question.choices else ""
    return option(_flag(name), help=f"{question.text}{allowed}.{more}")


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


@command()
@click.argument("file", required=False, default="mine.toml", type=click.Path(path_type=Path, dir_okay=False))
@_answer_options
@options.overwrite_option
@options.json_option
def new(file: Path, overwrite: bool, as_json: bool, **given: str | None) -> None:
    """Write FILE, an experiment file for a rig of your own, from the data sheets of its motor and encoder.

    In a terminal it asks for each value that no option gives. Numbers are in SI units, or have a unit: 38.5mNm/A,
    110gcm², 8cm, 60g. The file has the unit and the source of every number; values that no data sheet gives are
    assumed, marked and listed.

    Example: rig experiment new mine.toml --mechanism lever --torque-constant 38.5mNm/A --rotor-inertia 110gcm2
    --nominal-current 2.5A --encoder-lines 2048 --transmission 12 --handle-length 8cm --handle-mass 60g
    """
    asks = not as_json and sys.stdin is not None and sys.stdin.isatty() and not _is_complete(given)
    if file.exists() and not overwrite:
        if not asks or not click.confirm(f"{file} exists. Overwrite it?"):
            raise ConfigError(
                f"the file {file} exists already", remedy="give another name, or add --overwrite"
            )
        overwrite = True
    known = questions()
    answers = {name: known[name].read(_flag(name), text) for name, text in given.items() if text is not None}
    if asks:
        _ask(answers)
    made = new_rig(file, overwrite=overwrite, **answers)
    if as_json:
        output.print_json(made)
        return
    _print(made)
    name_next()


def _is_complete(given: dict[str, str | None]) -> bool:
    asked = questions_for(given["mechanism"] or "")
    return bool(asked) and all(question.assumed or given[name] for name, question in asked.items())


def _ask(answers: dict[str, Any]) -> None:
    click.echo(
        "From the data sheets of motor and encoder. Numbers in SI units, or with a unit: 38.5mNm/A, 110gcm2, 8cm."
    )
    if "mechanism" not in answers:
        answers["mechanism"] = _prompt("mechanism", questions()["mechanism"])
    for name, question in questions_for(answers["mechanism"]).items():
        if name not in answers:
            answers[name] = _prompt(name, question)


def _prompt(name: str, question: DataSheetQuestion) -> Any:

    def read(text: str) -> Any:
        if not text.strip() and question.assumed:
            return None
        try:
            return question.read(name, text)
        except ConfigError as error:
            raise click.UsageError(str(error)) from None

    text = question.text + (f", {' | '.join(question.choices)}" if question.choices else "")
    if question.assumed:
        return click.prompt(
            f"{text} [Enter: {question.assumed}]", default="", show_default=False, value_proc=read
        )
    return click.prompt(text, value_proc=read)


def _print(made: NewRig) -> None:
    click.echo(f"{made.path}: {made.experiment.headline()}")
    output.show(
        [
            Row("assumed" if number == 0 else "", f"{one.key} = {one.value}: {one.reason}")
            for number, one in enumerate(made.assumed)
        ]
    )
    click.echo("  Replace the assumed values by known ones; rig identify measures most of them.")
