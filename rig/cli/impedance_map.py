"""The command ``rig impedance map``: map where the impedance of a simulated rig's walls is passive.

`rig.experiments.mapping` computes the map; this file parses options and prints.
"""

import math
from pathlib import Path
from typing import Any

import click

from rig.cli import map_options, options, output
from rig.cli._keyword_options import gathered_options, keyword_options
from rig.cli.command import command
from rig.cli.progress import SweepBar
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.present import Table
from rig.core.sample import unit_of
from rig.experiments.mapping import interface as maps
from rig.experiments.mapping.interface import (
    FrequencyMap,
    FrequencyPlan,
    FrequencyWidth,
    GridSearch,
    Judging,
    SchemeRow,
    Spread,
    TableOne,
    frequency_plan,
    numbers_of,
    table_one,
)
from rig.experiments.trials.settings import ExcitationSettings


@command("map")
@options.file_argument
@options.rig_option(options.EXCITED_PRESET)
@options.set_option
@options.walls_options(
    "Stiffnesses of the grid. [60, up to a share of the limit of linear theory]",
    "Dampings of the grid. [16, likewise]",
)
@options.scheme_option("the paper's four estimators")
@options.judge_option
@keyword_options(ExcitationSettings, "band", "realisations", "periods", "amplitude", "seed")
@gathered_options(Judging, "judging")
@map_options.sweep_options
def map_(
    stiffness: str | None,
    damping: str | None,
    schemes: tuple[str, ...],
    judged: str | None,
    judging: Judging,
    directory: Path,
    plot: str,
    as_json: bool,
    workers: int | None,
    scheduler: str | None,
    **rig: Any,
) -> None:
    """Map where the impedance of a simulated rig's walls (K, B) is passive; the colour shows the fidelity.

    Every wall of a grid is excited. Without arguments: Figs. 5 to 8 and Table I of Chawda et al. on the simulated rig
    chawda-linear. The same command resumes a map that was stopped.
    """
    signal = None if judged is None else "truth" if judged == "true" else "count"
    experiment = options.excited_experiment(**rig)
    plan = _plan(experiment, schemes, stiffness, damping, signal=signal, judging=judging)
    place = maps.directory_for(plan, directory, "impedance-map")
    with SweepBar("columns", unit="runs", plain=as_json) as bar:
        found = maps.map_into(plan, place, scheduler=scheduler, workers=workers, watch=bar.watch)
    picture = output.drawn(found, place / f"impedance-map.{plot}") if plot else None
    if as_json:
        output.print_json({**maps.summary(found), "directory": str(place), "picture": picture})
        return
    _print(found, table_one(found))
    pairs = [("walls", str(place / found.table_name)), ("summary", str(place / maps.SUMMARY))]
    output.print_pairs([*pairs, ("picture", picture)] if picture else pairs)


def _plan(
    experiment: Experiment,
    schemes: tuple[str, ...],
    stiffness: str | None,
    damping: str | None,
    **others: Any,
) -> FrequencyPlan:
    return frequency_plan(
        experiment,
        [Scheme.parse(text) for text in schemes],
        stiffnesses=None if stiffness is None else numbers_of(stiffness, "--stiffness"),
        dampings=None if damping is None else numbers_of(damping, "--damping"),
        **others,
    )


def _print(found: FrequencyMap, table: TableOne) -> None:
    plan = found.plan
    rig = plan.experiment.rig
    stiffness, damping = (unit_of(q, rig.motion) for q in ("stiffness", "damping"))
    low, high = table.band_hz
    click.echo(f"{rig.name}: passive from {low:g} to {high:g} Hz (z-score {plan.judging.z_score:g})")
    click.echo(
        f"K in {stiffness}, steps of {table.stiffness_step:.4g}; B and fidelity in {damping}, B in steps of "
        f"{table.damping_step:.4g}"
    )
    for number, row in enumerate(table.rows):
        click.echo(f"  {_short(number, row)}: {row.label}; tuned: {', '.join(row.tuned) or 'nothing'}")
    rows: list[tuple[str, ...]] = [
        ("K-width", "by", "K", "at B", "B-width", "worst fidelity", "islands", "tuned")
    ]
    for number, row in enumerate(table.rows):
        rows += _scheme_lines(_short(number, row), row, table.realisations)
    output.print_table(Table(rows[0], rows[1:]))
    _print_common(table)
    rows = [("boundary search", "walls", "of", "K", "above", "below", "unseen", "ended by")]
    rows += [_search_line(_short(number, row), row.search, found) for number, row in enumerate(table.rows)]
    output.print_table(Table(rows[0], rows[1:]))
    for note in _notes(table):
        click.echo(f"  {note}")


def _short(number: int, row: SchemeRow) -> str:
    return f"{number + 1} {row.estimator}"


def _scheme_lines(name: str, row: SchemeRow, realisations: int) -> list[tuple[str, ...]]:
    widths, whole = row.widths, row.widths.together
    lines = [
        (name, "all together", *_width_cells(whole), str(len(whole.islands)), str(len(row.tuned))),
        (
            "",
            f"each of {realisations}",
            _spread(widths.stiffness),
            "",
            _spread(widths.damping),
            _spread(widths.worst_fidelity),
            "",
            "",
        ),
    ]
    if row.paper is not None:
        paper = row.paper
        lines.append(
            (
                "",
                "paper, on its rig",
                _number(paper.stiffness),
                "",
                _number(paper.damping),
                _number(paper.worst_fidelity),
                "",
                str(paper.tunable),
            )
        )
    return lines


def _width_cells(width: FrequencyWidth) -> tuple[str, ...]:
    return (
        f"{'≥ ' if width.stiffness_capped else ''}{_number(width.stiffness)}",
        _number(width.at_damping),
        f"{'≥ ' if width.damping_capped else ''}{_number(width.damping)}",
        _number(width.worst_fidelity),
    )


def _search_line(name: str, search: GridSearch, found: FrequencyMap) -> tuple[str, ...]:
    highest = found.plan.stiffnesses[search.highest] if search.highest >= 0 else 0.0
    return (
        name,
        str(len(search.path)),
        str(search.cells),
        _number(highest),
        str(search.above),
        str(search.below),
        str(search.unseen),
        search.ending,
    )


def _print_common(table: TableOne) -> None:
    if not table.points:
        click.echo("  no wall with damping is passive with all schemes: there is no common fidelity")
        return
    rows: list[tuple[str, ...]] = [
        (
            "fidelity at",
            *(f"K {_number(k)}, B {_number(b)}" for k, b in table.points),
            f"all {table.common_walls}",
        )
    ]
    for number in table.comparable:
        row = table.rows[number]
        rows.append((_short(number, row), *map(_spread, row.common), _spread(row.common_mean)))
    output.print_table(Table(rows[0], rows[1:]))


def _notes(table: TableOne) -> list[str]:
    notes = []
    widths = [row.widths.together for row in table.rows]
    if any(width.stiffness_capped or width.damping_capped for width in widths):
        notes.append("≥: the region extends beyond the grid")
    if any(width.islands for width in widths):
        notes.append(
            "islands: passive walls beyond a wall that is not passive; they do not count (hatched in "
            "the picture)"
        )
    if len(table.comparable) < len(table.rows):
        notes.append("schemes without a passive damped wall are left out of the fidelity at common walls")
    if table.points:
        notes.append(
            "fidelity at: the first common walls by K·B to the last, and the mean of all; over realisations"
        )
    if any(row.search.above for row in table.rows):
        notes.append(
            "boundary search: the number above is how many dampings ended on an island, beyond the "
            "connected region"
        )
    if any(width.gaps for width in widths):
        notes.append("at some dampings below a B-width the softest wall is not passive")
    if table.realisations == 1:
        notes.append(
            "one realisation: its variance does not contain the effects of friction that repeat in "
            "each period"
        )
    return notes


def _spread(spread: Spread) -> str:
    if spread.count == 0:
        return "–"
    doubt = "" if math.isnan(spread.deviation) else f" ± {_number(float(f'{spread.deviation:.2g}'))}"
    return _number(spread.mean) + doubt


def _number(value: float) -> str:
    return "–" if math.isnan(value) else f"{float(f'{value:.4g}'):.9g}"
