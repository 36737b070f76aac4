"""Command ``rig session analyse``: analyse a study, print and write its results."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from rig.cli import options, output
from rig.cli.command import OWN, command
from rig.core.present import Item, Table
from rig.extras.study import AnalysisOptions, StudyAnalysis, write_study_tables
from rig.extras.study import analyse as found_in
from rig.extras.study import report_tables as tables
from rig.extras.study.cli_report import write_report
from rig.views.report import counted

MEASURES = {"rule": "rule", "k50-person": "K50 person", "k50-automatic": "K50 automatic"}
_OFTEN_S = 0.2
_FEW = 3  # participants: each is printed


@command()
@click.argument("places", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="DIR…")
@click.option(
    "--measure",
    type=click.Choice(list(MEASURES)),
    default="rule",
    show_default=True,
    help="Definition of the printed limits: by the search rule, or as K50 of the person's or of the "
    "automatic verdicts. All three are computed.",
)
@click.option(
    "--hashes/--no-hashes", default=True, help="Verify the recordings against the hashes in the logs."
)
@options.across_option
@click.option(
    "--include-marked",
    is_flag=True,
    help="Also count limits that their verdicts do not support: searches that ended by `most` before "
    "enough turns, limits outside of their own interval, or not between a wall judged stable and "
    "one judged not stable.",
)
@options.seed_option("Seed of the bootstraps.", OWN, default=0, show_default=True)
@click.option("--report/--no-report", default=True, help="Draw pictures and write the report, one HTML file.")
@options.output_option(None, "Directory of tables, pictures and report. [analysis, in DIR]", "out")
@options.format_option("Format of the pictures beside the report, which contains its own.", "svg")
@options.json_option
def analyse(
    places: tuple[Path, ...],
    out: Path | None,
    measure: Any,
    hashes: bool,
    across: tuple[str, ...],
    include_marked: bool,
    seed: int,
    report: bool,
    ending: str,
    as_json: bool,
) -> None:
    """Analyse a study: limits with intervals, differences, agreement, order and fatigue.

    DIR is the directory of a study or of a participant. Trials and verdicts are read from the logs alone, with later
    corrections. Tables are written as CSV and Parquet, with a dictionary of their columns; the report is one HTML file.
    """
    chosen = AnalysisOptions(
        measure=MEASURES[measure],  # type: ignore[arg-type]
        hashes=hashes,
        across=across,
        seed=seed,
        include_marked=include_marked,
    )
    with Steps(quiet=as_json) as steps:
        found = found_in(places, chosen, watch=steps.watch)
        directory = beside(places, found) if out is None else out
        written = write_study_tables(found, directory)
        drawn, page = write_report(found, directory, ending, steps.watch) if report else ({}, None)
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


def beside(places: tuple[Path, ...], found: StudyAnalysis) -> Path:
    """Return the directory for results: ``analysis`` in the only given place, or in the sessions' common parent."""
    if len(places) == 1:
        return (places[0] if places[0].is_dir() else places[0].parent) / "analysis"
    parents = {session.directory.resolve().parent for session in found.study.sessions}
    return (parents.pop() if len(parents) == 1 else Path.cwd()) / "analysis"


class Steps:
    """Display of the current step of an analysis on standard error, if it is a terminal."""

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet or not output.on_terminal()
        self._printed_s = 0.0

    def __enter__(self) -> Steps:
        return self

    def __exit__(self, *error: object) -> None:
        if not self._quiet:
            click.echo("\r\033[K", nl=False, err=True)

    def watch(self, what: str, done: int, total: int) -> None:
        """Print a step and its progress, at most once every `_OFTEN_S` (s)."""
        now = time.monotonic()
        if not self._quiet and (done in (0, total) or now - self._printed_s >= _OFTEN_S):
            self._printed_s = now
            click.echo(f"\r\033[K{what}: {done} of {total}", nl=False, err=True)


def show(found: StudyAnalysis) -> None:
    """Print messages and the most important tables: limits, differences, agreement and slopes."""
    study, measure, counts = found.study, found.options.measure, found.counts()
    people = "simulated participant" if study.rehearsed else "participant"
    click.echo(
        f"{study.protocol.study.title}: {counted(len(study.sessions), people)}, {counts['recorded']} hits, "
        f"{counts.get('counted', 0)} of them counted"
    )
    for message in found.messages:
        click.echo(f"  {message}")
    limits = tables.over_participants(found, measure)
    if not limits.rows:
        click.echo(f"No complete run has a limit by {measure}.")
    few = len(study.sessions) <= _FEW
    shown = [limits, *([tables.tabulate_participants(found, measure)] if few else []), *_differences(found)]
    shown.append(
        tables.agreement(one for one in found.agreements if not one.condition and one.kappa is not None)
    )
    own = (one for one in found.slopes if one.measure in ("", measure) and not one.problem)
    shown.append(tables.slopes(found, own))
    output.show(
        tables.drop_empty_columns(item) if isinstance(item, Table) else item
        for item in shown
        if not isinstance(item, Table) or item.rows
    )


def _differences(found: StudyAnalysis) -> Iterator[Item]:
    model, first = tables.first_contrasts(found)
    if model is not None and model.problem:
        yield f"No mixed model: {model.problem}"
    methods = " and ".join(dict.fromkeys(method for _, method in first))
    tested = [one for one, _ in first if tables.has_interval(one)]
    yield tables.contrasts(found, tested, f"Differences between conditions, {methods}")
    paired = [one for one in found.paired if one.measure == found.options.measure]
    for problem, names in tables.group_untested(found, paired).items():
        yield f"No interval and no p value for {', '.join(names)}: {problem}"
    yield from (f"  {note}" for note in (model.notes if model is not None else ()))
