"""``rig kmax``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from rig.cli import hit_output, map_options, output
from rig.cli.command import EXPERIMENT, command, option
from rig.cli.progress import SweepBar
from rig.config.schemes import Scheme
from rig.core.present import Table
from rig.core.sample import unit_of
from rig.experiments import maps
from rig.experiments.kmax import KMax, kmax_plan
from rig.experiments.ranges import kmax_theory
from rig.experiments.searches import numbers_of
from rig.experiments.zwidth import OFFSETS, Boundary
from rig.views.plots.zwidth import draw_kmax

SPAN = 500.0  # highest stiffness over the lowest: at slow rates only soft walls are stable
DEFAULT_RATES = "100,200,500,1k,2k,5k,10k,20k,50k"


@command()
@map_options.map_options
@option(
    "-K",
    "--stiffness",
    group=EXPERIMENT,
    metavar="FROM:TO",
    help="Range of stiffness. [up to where the push rests trial.minimum_rest_counts deep]",
)
@option("--rates", group=EXPERIMENT, default=DEFAULT_RATES, show_default=True, help="Sampling rates.")
def kmax(
    file: Path | None,
    preset: str | None,
    stiffness: str | None,
    way: Any,
    ratio: float,
    offsets: str | None,
    repeats: int,
    judged: Any,
    workers: int | None,
    scheduler: str | None,
    directory: Path,
    plot: str,
    as_json: bool,
    rates: str,
    **push: Any,
) -> None:
    """Find the stiffest undamped wall at each sampling rate.

    Without arguments: Fig. 5 of Koul et al. on the simulated rig koul-compliant in a simulated hand.
    """
    experiment = map_options.chosen(file, preset, **push)
    each = map_options.rates(rates)
    schemes = [Scheme(position_rate=rate, velocity_rate=rate) for rate in each]
    plan = kmax_plan(
        experiment,
        map_options.search(experiment, stiffness, way, ratio, SPAN, schemes=schemes),
        rates=each,
        offsets=OFFSETS if offsets is None else numbers_of(offsets, "--offsets"),
        repeats=repeats,
    )
    plan = replace(plan, judged=judged or plan.judged)
    place = maps.directory_for(plan, directory, "kmax")
    with SweepBar("series", unit="ticks", plain=as_json) as bar:
        found = KMax.of(maps.map_into(plan, place, scheduler=scheduler, workers=workers, watch=bar.watch))
    picture = (
        output.drawn(lambda: draw_kmax(found, place / f"kmax.{plot}", theory=kmax_theory(found)))
        if plot
        else None
    )
    if as_json:
        output.print_json({**found.as_mapping(), "directory": str(place), "picture": picture})
        return
    _print(found)
    pairs = [("hits", f"{found.map.hits}, in {place / found.map.table_name}")]
    output.print_pairs([*pairs, ("picture", picture)] if picture else pairs)


def _limit(found: Boundary, lowest: float) -> str:
    if found.stiffness <= 0.0:
        return f"< {lowest:.4g}"
    scatter = f" ± {found.deviation:.2g}" if len(found.limits) > 1 else ""
    return f"{'≥ ' if found.capped else ''}{found.stiffness:.4g}{scatter}"


def _print(found: KMax) -> None:
    experiment = found.map.plan.experiment
    unit = unit_of("stiffness", experiment.rig.motion)
    click.echo(f"{experiment.rig.name}, {hit_output.push_text(experiment)}: largest K at B = 0 ({unit})")
    curves = {name: found.curve(name) for name in ("felt", "heard", "any")}
    rows = [("rate (Hz)", *curves)]
    for number, rate in enumerate(found.rates):
        row = [curve[number] for curve in curves.values()]
        rows.append((f"{rate}", *(_limit(b, found.map.plan.search.lowest) for b in row)))
    output.print_table(Table(rows[0], rows[1:]))
    for name in curves:
        ratio = found.saturation(name)
        if ratio is not None:
            click.echo(f"  {name}: K at {found.rates[-1] / 1e3:g} kHz is {ratio:.2f} of that at 20 kHz")
