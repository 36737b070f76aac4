"""Command ``rig estimators rank``: rank estimators and control laws by the range of walls that they render."""

from pathlib import Path

import click

from rig.cli import options, output
from rig.cli.command import command, option
from rig.cli.progress import SweepBar
from rig.core.errors import ConfigError
from rig.experiments.trials.results import make_directory
from rig.extras.papers.ranking import measure, rule
from rig.extras.papers.ranking.compare import RigResults, write_results
from rig.extras.papers.ranking.page import page
from rig.extras.papers.ranking.rule import Tuned
from rig.recording.files import whole_file


@command("rank")
@click.argument("rigs", nargs=-1, type=click.Choice(tuple(rule.RIGS)))
@option(
    "--entry",
    "entries",
    multiple=True,
    metavar="NAME:PARAMETER=LOW:HIGH",
    help="Also measure this estimator, tuned within these values of its parameter. May be repeated.",
)
@options.workers_option
@options.output_option("rankings", "Directory of results, page, and journals to resume from.", "directory")
@options.json_option
def rank(
    rigs: tuple[str, ...], entries: tuple[str, ...], workers: int | None, directory: Path, as_json: bool
) -> None:
    """Rank velocity estimators and control laws on RIGS (or all) by the range of walls that they render.

    The range is an area in the plane of stiffness and damping. Each rig and eight variations of its parameters are hit
    without a hand and in three grips, with 0, 1 and 2 ticks of delay. Writes a page of tables. All rigs take about 40
    minutes of one core; the same command resumes an interrupted ranking.
    """
    own = [_entry(text) for text in entries]
    make_directory(directory)
    found = []
    for name in rigs or rule.RIGS:
        click.echo(f"{name}: about {measure.estimate_s(name) / 60.0:.0f} min of one core", err=True)
        with SweepBar(f"ranking {name}", plain=as_json) as bar:
            found.append(
                measure.measure_rig(name, entries=own, directory=directory, workers=workers, watch=bar.watch)
            )
    write_results(found, directory / "results.json")
    with whole_file(directory / "ranking.md", overwrite=True) as file:
        file.write(page([RigResults(**one) for one in found]).encode())
    if as_json:
        output.print_json(found)
        return
    pairs = [("results", directory / "results.json"), ("page", directory / "ranking.md")]
    output.print_pairs([(name, str(path)) for name, path in pairs])


def _entry(text: str) -> Tuned:
    name, colon, rest = text.partition(":")
    parameter, equals, bounds = rest.partition("=")
    low, other, high = bounds.partition(":")
    try:
        if colon and equals and other and 0.0 < float(low) < float(high):
            return Tuned(
                estimator=name, parameter=parameter, low=float(low), high=float(high), per_rate=False
            )
    except ValueError:
        pass
    raise ConfigError(
        f"--entry {text} does not name an estimator and a range of one parameter",
        remedy="write NAME:PARAMETER=LOW:HIGH with two numbers above 0, like alpha-beta:bandwidth_hz=10:400",
    )
