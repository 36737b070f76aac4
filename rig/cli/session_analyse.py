"""``rig session analyse``."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import Any

import click

from rig.cli import output
from rig.cli.session_report import write_report
from rig.core.present import Table
from rig.session.analysis import Analysis, Options, write_tables
from rig.session.analysis import analyse as found_in

MEASURES = {"rule": "rule", "k50-person": "K50 person", "k50-automatic": "K50 automatic"}
_OFTEN_S = 0.2
_FEW = 3  # participants: each is printed


@click.command()
@click.argument("places", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="DIR…")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Where tables, pictures and report go. [default: analysis, in DIR]",
)
@click.option(
    "--measure",
    type=click.Choice(list(MEASURES)),
    default="rule",
    show_default=True,
    help="How limits are told in what is printed: by the search rule, or as K50 by the person's or the automatic "
    "verdicts, whatever rule asked. All are computed.",
)
@click.option("--hashes/--no-hashes", default=True, help="Compare recordings with the hashes in the logs.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the bootstraps.")
@click.option("--report/--no-report", default=True, help="Draw pictures and write the report, one HTML file.")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
def analyse(
    places: tuple[Path, ...],
    out: Path | None,
    measure: Any,
    hashes: bool,
    seed: int,
    report: bool,
    as_json: bool,
) -> None:
    """Analyse a study: limits with intervals, differences, agreement, order and fatigue.

    DIR is the directory of a study or of a participant. What the rig recorded and what was judged is read from the
    logs alone, corrections included; tables are written as CSV and Parquet, with a dictionary of their columns, and
    one HTML file tells everything, with pictures and the text of a paper's methods.
    """
    options = Options(measure=MEASURES[measure], hashes=hashes, seed=seed)  # type: ignore[arg-type]
    with Steps(quiet=as_json) as steps:
        found = found_in(places, options, watch=steps.watch)
        directory = beside(places, found) if out is None else out
        written = write_tables(found, directory)
        drawn, page = write_report(found, directory, steps.watch) if report else ({}, None)
    if as_json:
        output.print_json(
            {
                **found.as_mapping(),
                "tables": {name: str(path) for name, path in written.items()},
                "pictures": {name: str(path) for name, path in drawn.items()},
                "report": None if page is None else str(page),
            }
        )
        return
    show(found)
    output.print_pairs([("tables", f"{directory} ({len(written)} files, columns explained in tables.json)")])
    if page is not None:
        output.print_pairs([("report", str(page))])


def beside(places: tuple[Path, ...], found: Analysis) -> Path:
    """The directory ``analysis`` in the only place that was named, or where all sessions lie."""
    if len(places) == 1:
        return (places[0] if places[0].is_dir() else places[0].parent) / "analysis"
    parents = {session.directory.resolve().parent for session in found.study.sessions}
    return (parents.pop() if len(parents) == 1 else Path.cwd()) / "analysis"


class Steps:
    """Says on standard error what is being done, on a terminal only."""

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet or sys.stderr is None or not sys.stderr.isatty()
        self._said_s = 0.0

    def __enter__(self) -> Steps:
        return self

    def __exit__(self, *error: object) -> None:
        if not self._quiet:
            click.echo("\r\033[K", nl=False, err=True)

    def watch(self, what: str, done: int, total: int) -> None:
        """Show a step, a few times a second at most."""
        now = time.monotonic()
        if not self._quiet and (done in (0, total) or now - self._said_s >= _OFTEN_S):
            self._said_s = now
            click.echo(f"\r\033[K{what}: {done} of {total}", nl=False, err=True)


def show(found: Analysis) -> None:
    """Print what matters most."""
    study, measure = found.study, found.options.measure
    people = f"{len(study.sessions)} {'simulated ' if study.rehearsed else ''}participant"
    counts = found.counts()
    click.echo(
        f"{study.protocol.study.title}: {people}{'' if len(study.sessions) == 1 else 's'}, {counts['recorded']} hits, "
        f"{counts.get('counted', 0)} of them told limits"
    )
    for message in found.messages:
        click.echo(f"  {message}")
    _show_limits(found)
    _show_differences(found)
    kappas = [one for one in found.agreements if one.condition == "" and one.weights != "linear"]
    if kappas:
        click.echo(
            "Person and automatic verdict (Cohen's κ; walls near the limit are asked most, so it reads low):"
        )
        output.print_table(
            Table(
                ("", "κ", "95 %", "over", "same", "trials"),
                [
                    (
                        one.name + (", weighted" if one.weights == "quadratic" else ""),
                        _share(one.kappa),
                        "–" if one.low is None else f"{_share(one.low)} … {_share(one.high)}",
                        one.over,
                        "–" if one.share is None else f"{100 * one.share:.0f} %",
                        str(one.trials),
                    )
                    for one in kappas
                ],
            )
        )
        for problem in dict.fromkeys(one.problem for one in kappas if one.problem):
            click.echo(f"  no interval: {problem}")
    slopes = [one for one in found.slopes if one.measure in ("", measure) and not one.problem]
    if slopes:
        click.echo("Along the session, exploratory:")
        output.print_table(
            Table(
                ("", "slope", "95 %", "p (Holm)"),
                [
                    (
                        f"{one.of} for each {_WORDS[one.along]}",
                        f"{one.slope:.3g}",
                        _range(one.low, one.high),
                        _p(one.holm),
                    )
                    for one in slopes
                ],
            )
        )


_OPEN = {"": "", "least": "≥ ", "most": "≤ ", "unknown": "? "}
_WORDS = {"order": "place in the block", "block": "block", "trial": "trial"}


def _show_limits(found: Analysis) -> None:
    unit, measure = found.study.unit("stiffness"), found.options.measure
    rows = [
        (
            f"{one.condition}, B = {one.damping:g}",
            f"{_bound(one.above, one.below)}{one.mean:.4g}",
            _range(one.low, one.high),
            f"{one.deviation:.2g}" if math.isfinite(one.deviation) else "–",
            str(one.participants),
            str(one.runs),
        )
        for one in found.over_participants
        if one.measure == measure
    ]
    if not rows:
        click.echo(f"No complete run has a limit by {measure}.")
        return
    click.echo(f"K_max by {measure} ({unit}), over participants:")
    output.print_table(Table(("", "mean", "95 %", "SD", "people", "runs"), rows))
    people = [one for one in found.of_participants if one.measure == measure]
    if len(found.study.sessions) > _FEW:
        return
    click.echo(f"K_max by {measure} ({unit}), each participant:")
    output.print_table(
        Table(
            ("", "mean", "95 %", "of", "bootstrap", "runs"),
            [
                (
                    f"{one.participant}, {one.condition}, B = {one.damping:g}",
                    f"{_bound(one.above, one.below)}{one.mean:.4g}",
                    _range(one.low, one.high),
                    one.interval,
                    _range(one.bootstrap_low, one.bootstrap_high),
                    str(one.repeats),
                )
                for one in people
            ],
        )
    )


def _show_differences(found: Analysis) -> None:
    unit, measure = found.study.unit("stiffness"), found.options.measure
    model = next((one for one in found.mixed if one.measure == measure), None)
    mixed = model is not None and bool(model.contrasts)
    paired = [one for one in found.paired if one.measure == measure and one.participants > 1]
    bounds = [one for one in paired if one.withheld]
    contrasts: Any = [*model.contrasts, *bounds] if mixed and model else paired
    if model is not None and model.problem:
        click.echo(f"No mixed model: {model.problem}")
    if contrasts:
        click.echo(f"Differences ({unit}), {'mixed model' if mixed else 'paired within participants'}:")
        rows = [
            (
                f"{one.condition} − {one.against}, "
                + ("all B" if one.damping is None else f"B = {one.damping:g}"),
                f"{_OPEN[one.bound]}{one.difference:+.4g}",
                _range(one.low, one.high),
                _p(one.holm),
                f"{one.beyond.count} of {one.beyond.limits}",
            )
            for one in contrasts
        ]
        output.print_table(Table(("", "mean", "95 %", "p (Holm)", "beyond the levels"), rows))
    for note in () if model is None else model.notes:
        click.echo(f"  {note}")


def _bound(above: int, below: int) -> str:
    if above and below:
        return "? "
    return "≥ " if above else "≤ " if below else ""


def _range(low: float | None, high: float | None) -> str:
    if low is None or high is None or math.isnan(low) or math.isnan(high):
        return "–"
    if math.isinf(high):
        return f"{low:.4g} … ∞" if low > 0.0 else "–"
    return f"{low:.4g} … {high:.4g}"


def _share(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _p(value: float) -> str:
    if not math.isfinite(value):
        return "–"
    return "< 0.001" if value < 0.001 else f"{value:.3f}"
