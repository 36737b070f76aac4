"""``rig zwidth``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rig import config
from rig.cli import hit_output, map_options, options, output
from rig.cli.command import command
from rig.cli.next_step import name_next
from rig.cli.progress import SweepBar
from rig.cli.zwidth_explained import explain, explain_option
from rig.cli.zwidth_frequency import frequency_options, map_frequency, of_frequency, refuse_of_the_other
from rig.cli.zwidth_rig import CONFIRM, CRITERIA, Dialogue, load_device, refuse_without_device
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.core.present import Table
from rig.core.sample import unit_of
from rig.experiments import maps
from rig.experiments.plan import stands_for_device
from rig.experiments.ranges import SPAN, hit_plan, theory_curves
from rig.experiments.rendering import RENDERED
from rig.experiments.searches import numbers_of
from rig.experiments.zwidth import Width, ZWidth
from rig.views.plots.zwidth import draw_zwidth


@command()
@map_options.map_options
@options.walls_options(
    "Range of stiffness, FROM:TO; excited: a list or FROM:TO:N. [up to where the push rests trial.minimum_rest_counts "
    "deep]",
    "Dampings. [17, to beyond the limit of the linear theory]",
)
@options.scheme_option("the experiment's and the uniform ones of its rates")
@options.url_option("simulates without a link")
@options.realtime_option("A simulated device (sim://) as a process, in real time.")
@options.verified_option
@options.confirm_option(CONFIRM, "each hit; no with a simulated device")
@explain_option
@frequency_options
def zwidth(
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
    schemes: tuple[str, ...],
    damping: str | None,
    url: str | None,
    realtime: bool,
    verified: bool,
    confirm: str | None,
    domain: str,
    explained: bool,
    **push: Any,
) -> None:
    """Map the walls (K, B) that a rig renders stably, by hitting them; or passively, by exciting it.

    Without arguments: Fig. 6 of Koul et al. on the simulated rig koul-compliant in a simulated hand. The same command
    resumes a map that was stopped.

    With --url the walls are hit on a device, one after the other: a person agrees, the handle goes to its start and
    into the wall, the motor cools. Every hit is recorded.

    With --explain: where linear theory and hits differ, and why, as a picture and a paragraph to cite.

    With --domain frequency: Figs. 5 to 8 and Table I of Chawda et al. on the simulated rig chawda-linear. Every wall of
    a grid (-K and -B as first:last:count) is excited; where its impedance is passive, its fidelity is the colour.
    """
    refuse_of_the_other(domain)
    excitation = {name: push.pop(name) for name in of_frequency()}
    if domain == "frequency":
        map_frequency(
            file=file, preset=preset, schemes=schemes, stiffness=stiffness, damping=damping, judged=judged,
            directory=directory, plot=plot, as_json=as_json, workers=workers, scheduler=scheduler,
            sets=push["sets"], seed=push["seed"], cutoff=push["cutoff"], **excitation,
        )  # fmt: skip
        return
    device = url is not None or realtime
    if device:
        _refuse_with_device(workers, scheduler)
        if explained:
            raise ConfigError(
                "--explain takes parts of a simulated rig out; a device keeps them", remedy="drop one of both"
            )
        url = url or "sim://"
    else:
        refuse_without_device(verified, confirm)
    experiment = map_options.chosen(file, preset or options.preset_of(url, file), **push, device=device)
    if url is not None:
        load_device(url)
    if realtime or (url is not None and not url.startswith("sim:")):
        experiment = _in_real_time(experiment)
    chosen = [Scheme.parse(text) for text in schemes]
    plan = hit_plan(
        experiment,
        chosen,
        dampings=None if damping is None else numbers_of(damping, "--damping"),
        search=map_options.search(experiment, stiffness, way, ratio, _span(), schemes=chosen, device=device),
        offsets=None if offsets is None else numbers_of(offsets, "--offsets"),
        repeats=repeats,
        judged=judged,
        on_device=device,
    )
    if explained:
        explain(plan, directory, plot, as_json, workers=workers, scheduler=scheduler)
        return
    if url is None:
        place = maps.directory_for(plan, directory, "zwidth")
        with SweepBar("series", unit="ticks", plain=as_json) as bar:
            found = maps.map_into(plan, place, scheduler=scheduler, workers=workers, watch=bar.watch)
    else:
        dialogue = Dialogue(plan, url, realtime=realtime, confirm=confirm)
        place, found = dialogue.map(directory, verified=verified)
    picture = (
        output.drawn(lambda: draw_zwidth(found, place / f"zwidth.{plot}", theory=theory_curves(plan)))
        if plot
        else None
    )
    if as_json:
        output.print_json({**found.as_mapping(), "directory": str(place), "picture": picture})
        return
    _print(found)
    pairs = [
        ("hits", f"{found.hits}, in {place / found.table_name}"),
        ("summary", str(place / maps.SUMMARY)),
    ]
    output.print_pairs([*pairs, ("picture", picture)] if picture else pairs)
    name_next()


def _span() -> float:
    return SPAN


def _in_real_time(experiment: Experiment) -> Experiment:
    return config.with_realtime(experiment)


def _refuse_with_device(workers: int | None, scheduler: str | None) -> None:
    if workers is not None or scheduler is not None:
        raise ConfigError(
            "a device is hit by one program at a time", remedy="drop --workers and --scheduler, or --url"
        )


def _print(found: ZWidth) -> None:
    experiment = found.plan.experiment
    stiffness, damping = (unit_of(q, experiment.rig.motion) for q in ("stiffness", "damping"))
    by = (
        "; judged by the simulation's truth, not by what a rig records" if found.plan.judged == "true" else ""
    )
    click.echo(
        f"{experiment.rig.name}, {hit_output.push_text(experiment)}: K in {stiffness}, B in {damping}{by}"
    )
    rows: list[tuple[str, ...]] = [("scheme", "criterion", "K at B = 0", "K peak", "at B", "B range", "area")]
    for number, scheme in enumerate(found.plan.schemes):
        for criterion in CRITERIA:
            width = found.width(number, criterion)
            label = scheme.label(experiment) if criterion == CRITERIA[0] else ""
            rows.append((label, criterion, *_cells(width)))
    output.print_table(Table(rows[0], rows[1:]))
    for note in _notes(found):
        click.echo(f"  {note}")


def _notes(found: ZWidth) -> list[str]:
    notes = [] if found.cutoffs is None else [found.cutoffs]
    if any(b.capped for b in found.boundaries):
        notes.append(
            "≥ before K: some series reached the highest stiffness before a wall failed; the limit lies above: "
            "push harder (--effort), which makes another map"
        )
    widths = [found.width(number, name) for number in range(len(found.plan.schemes)) for name in CRITERIA]
    if any(width.range_capped for width in widths):
        notes.append("≥ before B: the map ends before the range of the scheme does")
    notes += _holes(found)
    dropped = {
        number: found.width(number, CRITERIA[0]).not_rendered for number in range(len(found.plan.schemes))
    }
    for number, dampings in dropped.items():
        if dampings:
            label = found.plan.schemes[number].label(found.plan.experiment)
            notes.append(
                f"{label}: no wall counts from B = {dampings[0]:.3g} on: one encoder count asks for more than the "
                f"effort limit, which leaves less than {RENDERED:.0%} of the damping; filter the velocity more, or "
                "sample it more slowly"
            )
    if any(limit.islands for b in found.boundaries for limit in b.limits):
        notes.append(
            "there are islands: stiffer walls that are stable beyond one that is not (see the picture)"
        )
    if found.of_device_loop:
        notes.append(stands_for_device(found.plan.experiment))
    unknown = sum(b.unknown for b in found.boundaries if b.criterion == "any")
    if unknown:
        why = ", ".join(f"{reason} ({number})" for reason, number in found.invalid().items())
        notes.append(f"{unknown} of {found.hits} hits were invalid: {why}")
    return notes


def _holes(found: ZWidth) -> list[str]:
    """Name the dampings at which no wall passed below others at which some did."""
    notes = []
    for number, scheme in enumerate(found.plan.schemes):
        holes = {name: found.width(number, name).holes for name in CRITERIA}
        if any(holes.values()):
            which = "; ".join(
                f"{', '.join(f'{b:.3g}' for b in b_s)} ({name})" for name, b_s in holes.items() if b_s
            )
            notes.append(
                f"{scheme.label(found.plan.experiment)}: no wall passed at B = {which}, from the softest one "
                f"on that was hit, K = {found.plan.search.lowest:.4g}; the area is a lower bound. Softer walls: "
                "--stiffness FROM:TO"
            )
    return notes


def _cells(width: Width) -> tuple[str, ...]:
    if width.stiffness_undamped is None:
        undamped = "–"
    elif width.stiffness_undamped <= 0.0:
        undamped = f"< {width.lowest:.4g}"
    else:
        undamped = f"{'≥ ' if width.undamped_capped else ''}{width.stiffness_undamped:.4g}"
    bound = width.capped or width.range_capped or width.holes
    return (
        undamped,
        f"{'≥ ' if width.capped else ''}{width.stiffness_peak:.4g}",
        f"{width.damping_at_peak:.3g}",
        f"{'≥ ' if width.range_capped else ''}{width.damping_range:.3g}",
        f"{'≥ ' if bound else ''}{width.area:.4g}",
    )
