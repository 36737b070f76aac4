"""The command ``rig zwidth``: map the walls that a rig renders stably.

`rig.experiments.mapping` simulates or measures the hits; this file parses options, prints and draws.
"""

from pathlib import Path
from typing import Any

import click

from rig import config
from rig.cli import _hit_output as hit_output
from rig.cli import map_options, options, output
from rig.cli._keyword_options import gathered_options
from rig.cli._next_step import name_next
from rig.cli._zwidth_rig import CONFIRM, CRITERIA, Dialogue, load_device, refuse_without_device
from rig.cli.command import command
from rig.cli.progress import SweepBar
from rig.core.errors import ConfigError
from rig.core.present import Table
from rig.core.sample import unit_of
from rig.experiments.mapping import interface as maps
from rig.experiments.mapping.interface import RENDERED, Boundary, KMax, MapRequest, Width, ZWidth
from rig.experiments.trials.plan import stands_for_device


@command()
@map_options.hit_experiment_options
@gathered_options(MapRequest, "walls")
@options.url_option("simulate, without a link")
@options.realtime_option("A simulated device (sim://) as a process, in real time.")
@options.verified_option
@options.confirm_option(CONFIRM, "each hit; no for a simulated device")
@map_options.sweep_options
def zwidth(
    walls: MapRequest,
    url: str | None,
    realtime: bool,
    verified: bool,
    confirm: str | None,
    workers: int | None,
    scheduler: str | None,
    directory: Path,
    plot: str,
    as_json: bool,
    **rig: Any,
) -> None:
    """Map the walls (K, B) that a rig renders stably, scheme by scheme, by hitting them.

    Without arguments: Fig. 6 of Koul et al. on the simulated rig koul-compliant in a simulated hand. The same command
    resumes a map that was stopped.

    With -B 0: the stiffest undamped wall at each sampling rate, as in Fig. 5 of Koul et al.

    With --url the walls are hit on a device, one after the other: a person agrees, the handle moves to its start and
    into the wall, the motor cools. Every hit is recorded.

    `rig theory disagreement` shows where linear theory and these hits differ, and why; `rig impedance map` maps where
    the rendered impedance is passive.
    """
    device = url is not None or realtime
    if device:
        _refuse_with_device(workers, scheduler)
        url = url or "sim://"
        load_device(url)
    else:
        refuse_without_device(verified, confirm)
    experiment = map_options.chosen(**rig, url=url, device=device)
    if realtime or (url is not None and not url.startswith("sim:")):
        experiment = config.with_realtime(experiment)
    plan = walls.plan(experiment, on_device=device)
    if url is None:
        place = maps.directory_for(plan, directory, "zwidth")
        with SweepBar("series", unit="ticks", plain=as_json) as bar:
            found = maps.map_into(plan, place, scheduler=scheduler, workers=workers, watch=bar.watch)
    else:
        dialogue = Dialogue(plan, url, realtime=realtime, confirm=confirm)
        place, found = dialogue.map(directory, verified=verified)
    undamped = KMax.of(found) if KMax.is_of(plan) else None
    picture = output.drawn(undamped or found, place / f"zwidth.{plot}") if plot else None
    if as_json:
        output.print_json({**(undamped or found).as_mapping(), "directory": str(place), "picture": picture})
        return
    if undamped is None:
        _print(found)
    else:
        _print_undamped(undamped)
    pairs = [
        ("hits", f"{found.hits}, in {place / found.table_name}"),
        ("summary", str(place / maps.SUMMARY)),
    ]
    output.print_pairs([*pairs, ("picture", picture)] if picture else pairs)
    name_next()


def _refuse_with_device(workers: int | None, scheduler: str | None) -> None:
    if workers is not None or scheduler is not None:
        raise ConfigError(
            "--workers and --scheduler are given with --url: a device can be hit by one program only",
            remedy="drop --workers and --scheduler, or drop --url",
        )


def _print(found: ZWidth) -> None:
    experiment = found.plan.experiment
    stiffness, damping = (unit_of(q, experiment.rig.motion) for q in ("stiffness", "damping"))
    by = (
        "; judged by the true signals of the simulation, not by those that a rig records"
        if found.plan.judged == "true"
        else ""
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


def _print_undamped(found: KMax) -> None:
    experiment = found.map.plan.experiment
    unit = unit_of("stiffness", experiment.rig.motion)
    click.echo(f"{experiment.rig.name}, {hit_output.push_text(experiment)}: largest K at B = 0 ({unit})")
    curves = {name: found.curve(name) for name in CRITERIA}
    rows = [
        (f"{rate}", *(_limit(curve[number], found.map.plan.search.lowest) for curve in curves.values()))
        for number, rate in enumerate(found.rates)
    ]
    output.print_table(Table(("rate (Hz)", *curves), rows))
    for name in curves:
        ratio = found.saturation(name)
        if ratio is not None:
            click.echo(f"  {name}: K at {found.rates[-1] / 1e3:g} kHz is {ratio:.2f} of that at 20 kHz")


def _limit(found: Boundary, lowest: float) -> str:
    if found.stiffness <= 0.0:
        return f"< {lowest:.4g}"
    scatter = f" ± {found.deviation:.2g}" if len(found.limits) > 1 else ""
    return f"{'≥ ' if found.capped else ''}{found.stiffness:.4g}{scatter}"


def _notes(found: ZWidth) -> list[str]:
    notes = [] if found.cutoffs is None else [found.cutoffs]
    if any(boundary.capped for boundary in found.boundaries):
        notes.append(
            "≥ before K: some series reached the highest stiffness before a wall failed, so the "
            "limit is higher: push harder (--effort; this begins another map)"
        )
    widths = [found.width(number, name) for number in range(len(found.plan.schemes)) for name in CRITERIA]
    if any(width.range_capped for width in widths):
        notes.append("≥ before B: the range of the scheme extends beyond the map")
    notes += _holes(found)
    dropped = {
        number: found.width(number, CRITERIA[0]).not_rendered for number in range(len(found.plan.schemes))
    }
    for number, dampings in dropped.items():
        if dampings:
            label = found.plan.schemes[number].label(found.plan.experiment)
            notes.append(
                f"{label}: walls from B = {dampings[0]:.3g} on do not count: one encoder count "
                f"commands more than the effort limit, so less than {RENDERED:.0%} of the damping is "
                "rendered; filter the velocity more, or sample it more slowly"
            )
    if any(limit.islands for boundary in found.boundaries for limit in boundary.limits):
        notes.append(
            "there are islands: stable walls that are stiffer than an unstable one (see the picture)"
        )
    if found.of_device_loop:
        notes.append(stands_for_device(found.plan.experiment))
    unknown = sum(boundary.unknown for boundary in found.boundaries if boundary.criterion == "any")
    if unknown:
        why = ", ".join(f"{reason} ({number})" for reason, number in found.invalid().items())
        notes.append(f"{unknown} of {found.hits} hits were invalid: {why}")
    return notes


def _holes(found: ZWidth) -> list[str]:
    """Return a note for each sampling scheme with a damping without stable wall, below one with stable walls."""
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
