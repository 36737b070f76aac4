"""``rig zwidth``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli import maps, output
from rig.cli.progress import SweepBar
from rig.sample import unit_of

if TYPE_CHECKING:
    from rig.experiments.zwidth import Width, ZWidth

DEFAULT_SCHEMES = ("dual:20k/2k", "uniform:20k", "uniform:2k")
CRITERIA = ("felt", "heard", "any")  # rig.verdict.CRITERIA, without its imports


@click.command()
@maps.map_options
@click.option(
    "--scheme",
    "schemes",
    multiple=True,
    metavar="SCHEME",
    help=f"dual:20k/2k, uniform:20k,cutoff_hz=1000, dual:20k/2k,estimator=kalman …; repeat it. "
    f"[{' '.join(DEFAULT_SCHEMES)}]",
)
@click.option(
    "-B",
    "--damping",
    help="Dampings: 0,0.5,1 or first:last:count. [17, to beyond the limit of the linear theory]",
)
def zwidth(
    file: Path | None,
    preset: str | None,
    stiffness: str | None,
    way: Any,
    ratio: float,
    offsets: str,
    repeats: int,
    judged: Any,
    workers: int | None,
    scheduler: str | None,
    directory: Path,
    plot: bool,
    as_json: bool,
    schemes: tuple[str, ...],
    damping: str | None,
    **push: Any,
) -> None:
    """Map the walls (K, B) that a rig renders stably, by hitting them.

    Without arguments: Fig. 6 of Koul et al. on the simulated rig koul-compliant in a simulated hand. A map that was
    stopped goes on when the same command is given again.
    """
    from rig.schemes import Scheme  # noqa: PLC0415

    experiment = maps.chosen(file, preset, **push)
    with output.compiling():
        from rig.experiments import map_files, ranges  # noqa: PLC0415  (imports compile)
        from rig.experiments.zwidth import MapPlan  # noqa: PLC0415

        parsed = tuple(Scheme.parse(text) for text in schemes or DEFAULT_SCHEMES)
        plan = MapPlan(
            experiment=experiment,
            schemes=parsed,
            dampings=(
                maps.numbers(damping, "--damping") if damping else ranges.dampings_for(experiment, parsed)
            ),
            search=maps.search(experiment, stiffness, way, ratio, ranges.SPAN),
            offsets=maps.numbers(offsets, "--offsets"),
            repeats=repeats,
            judged=judged,
        )
    place = map_files.directory_for(plan, directory, "zwidth")
    with SweepBar("climbs", unit="ticks", plain=as_json) as bar:
        found = map_files.map_into(plan, place, scheduler=scheduler, workers=workers, watch=bar.watch)
    picture = _draw(found, place / "zwidth.png") if plot else None
    if as_json:
        output.print_json({**found.as_mapping(), "directory": str(place), "picture": picture})
        return
    _print(found)
    pairs = [
        ("hits", f"{found.hits}, in {place / map_files.TABLE}"),
        ("summary", str(place / map_files.SUMMARY)),
    ]
    output.print_pairs([*pairs, ("picture", picture)] if picture else pairs)


def _draw(found: ZWidth, path: Path) -> str:
    from rig.experiments.ranges import theory_curves  # noqa: PLC0415
    from rig.plots.zwidth import draw_zwidth  # noqa: PLC0415

    return str(draw_zwidth(found, path, theory=theory_curves(found.plan)))


def _print(found: ZWidth) -> None:
    experiment = found.plan.experiment
    stiffness, damping = (unit_of(q, experiment.rig.motion) for q in ("stiffness", "damping"))
    click.echo(f"{experiment.rig.name}, {output.push_text(experiment)}: K in {stiffness}, B in {damping}")
    rows: list[tuple[str, ...]] = [("scheme", "criterion", "K at B = 0", "K peak", "at B", "B range", "area")]
    for number, scheme in enumerate(found.plan.schemes):
        for criterion in CRITERIA:
            width = found.width(number, criterion)
            label = scheme.label(experiment) if criterion == CRITERIA[0] else ""
            rows.append((label, criterion, *_cells(width)))
    output.print_table(rows)
    notes = []
    if any(b.capped for b in found.boundaries):
        notes.append(
            "≥: some climbs reached the highest stiffness before the wall failed; the limit lies above"
        )
    if any(limit.islands for b in found.boundaries for limit in b.limits):
        notes.append("there are islands: stiffer walls that hold beyond one that fails (see the picture)")
    unknown = sum(b.unknown for b in found.boundaries if b.criterion == "any")
    if unknown:
        notes.append(
            f"{unknown} of {found.hits} hits said nothing (invalid; see the column kind of the table)"
        )
    for note in notes:
        click.echo(f"  {note}")


def _cells(width: Width) -> tuple[str, ...]:
    least = "≥ " if width.capped else ""
    undamped = "–" if width.stiffness_undamped is None else f"{width.stiffness_undamped:.4g}"
    return (
        undamped,
        f"{least}{width.stiffness_peak:.4g}",
        f"{width.damping_at_peak:.3g}",
        f"{width.damping_range:.3g}",
        f"{width.area:.4g}",
    )
