"""The command ``rig design``: find rates, estimator and filter for a rig.

`rig.experiments.design` searches; this file reads the wishes from options, asks a person before it measures on a rig,
and writes the files. It must not rate a scheme.
"""

import shlex
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from rig import config
from rig.cli import map_options, options, output
from rig.cli._design_report import write_design_report
from rig.cli._next_step import name_next
from rig.cli._zwidth_rig import CONFIRM, Dialogue, load_device, refuse_without_device
from rig.cli.command import RESULT, command, option
from rig.cli.progress import SweepBar
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.experiments.design import (
    GOALS,
    STAGE,
    Design,
    DesignRequest,
    LawPlace,
    Wishes,
    design,
    directory_for,
    places_for,
    places_of,
)
from rig.experiments.mapping.interface import hit_plan, search_for
from rig.experiments.sweep import Progress
from rig.experiments.trials.results import write_document
from rig.firmware.tick_budget import BOARD, INTEGERS, named_budget
from rig.recording.files import whole_file

WISHES, ALLOWED = "Wishes", "What is allowed"
SUMMARY, SECTION = "design.json", "controller.toml"
# Number of dampings of the map on a rig, and ratio of neighbouring stiffnesses of its bisection.
ON_RIG_COLUMNS, ON_RIG_RATIO = 3, 1.06


@command("design")
@options.file_argument
@options.rig_option()
@options.operator_option(
    "Grip of the simulated hand that pushes (relaxed, normal, firm), or none: the motor pushes. [as "
    "in FILE; a built-in rig: normal]"
)
@options.effort_option
@options.set_option
@options.seed_option("Seed of all random numbers.")
@option(
    "--goal",
    group=WISHES,
    type=click.Choice(GOALS),
    default="area",
    show_default=True,
    help="Measure by which schemes are ranked.",
)
@option(
    "--must-be-stable",
    group=WISHES,
    is_flag=True,
    help="Require that the wall of -K and -B (or of the experiment) is stable.",
)
@option(
    "-K",
    "--stiffness",
    group=WISHES,
    type=float,
    help="Stiffness of the wall that must be stable (N·m/rad or N/m).",
)
@option(
    "-B",
    "--damping",
    group=WISHES,
    type=float,
    help="Damping of the wall that must be stable (N·m·s/rad or N·s/m).",
)
@option("--felt", group=WISHES, type=float, help="Largest rms velocity in the tail (m/s at the handle).")
@option("--heard", group=WISHES, type=float, help="Largest rms ripple of the effort (N at the handle).")
@option(
    "--moved", group=WISHES, type=float, help="Largest travel in the tail, peak to peak (m at the handle)."
)
@option(
    "--fidelity-to", group=WISHES, type=float, help="Render velocity faithfully up to this frequency (Hz)."
)
@option("--most-noise", group=WISHES, type=float, help="Largest rms velocity at rest (rad/s or m/s).")
@option("--most-cost", group=WISHES, type=float, help="Most cycles of the estimator per tick, on --board.")
@option(
    "--most-rate",
    group=ALLOWED,
    type=options.Hertz(10, 200_000),
    metavar="RATE",
    help="Highest position rate of the board. [the experiment's]",
)
@option(
    "--loop",
    group=ALLOWED,
    type=click.Choice(["host", "device", "both"]),
    help="Where the law may run. [as in the experiment]",
)
@option(
    "--round-trip",
    group=ALLOWED,
    type=float,
    metavar="S",
    help="Round trip of the link, for a law on this computer (s).",
)
@option(
    "--board",
    group=ALLOWED,
    default=BOARD,
    show_default=True,
    help="Board for which cycles are counted when the law runs on the device.",
)
@option("--link", group=ALLOWED, type=float, metavar="BYTES/S", help="Capacity of the link. [unlimited]")
@options.scheme_option("a built-in list of some hundred", ALLOWED)
@option(
    "--paper",
    group=RESULT,
    is_flag=True,
    help="Also compare the whole set with the schemes of the paper that describes the rig, in each "
    "measure of that paper.",
)
@options.workers_option
@options.scheduler_option
@options.url_option("simulate, without a link")
@options.verified_option
@options.confirm_option(CONFIRM, "each hit; no for a simulated device")
@options.output_option(None, "Also write the recommended [controller] section to this file.", "section")
@option(
    "--directory",
    group=RESULT,
    type=click.Path(path_type=Path),
    default=Path("designs"),
    show_default=True,
    help="Directory that stores each design, to resume from.",
)
@options.plot_options()
@options.json_option
def design_(
    file: Path | None,
    preset: str | None,
    operator: str | None,
    effort: float | None,
    sets: tuple[str, ...],
    seed: int | None,
    must_be_stable: bool,
    stiffness: float | None,
    damping: float | None,
    schemes: tuple[str, ...],
    cutoff: str | None,
    paper: bool,
    workers: int | None,
    scheduler: str | None,
    url: str | None,
    verified: bool,
    confirm: str | None,
    section: Path | None,
    directory: Path,
    plot: str,
    as_json: bool,
    **asked: Any,
) -> None:
    """Find rates, estimator and filter for a rig that fulfil given wishes, and write a [controller] section to paste.

    The search rates schemes (rates, estimator, filter) by linear theory, and then simulates hits with the best, with a
    coarse stiffness step first. The same command resumes a stopped search. The result has the Pareto front of the
    schemes, the stability margin on rigs that differ by 20 % and in other hands, a picture and a page.

    With --url only schemes are rated that device and link permit, and the stable walls of the recommended and of the
    experiment's own scheme are then measured on the rig, as with rig zwidth --url: a person must agree.
    """
    if url is None:
        refuse_without_device(verified, confirm)
    sets = (*sets, *_limits(asked))
    experiment = map_options.chosen(
        file, preset, operator, effort, seed, sets, cutoff, url=url, device=url is not None
    )
    request = DesignRequest(
        experiment=experiment,
        wishes=Wishes(
            goal=asked["goal"],
            wall=_wall(experiment, must_be_stable, stiffness, damping),
            fidelity_hz=asked["fidelity_to"],
            noise=asked["most_noise"],
            cost=asked["most_cost"],
        ),
        places=_places(experiment, url, asked),
        schemes=tuple(Scheme.parse(text) for text in schemes),
        paper=paper,
    )
    place = directory_for(request, directory)
    with ExitStack() as stack:
        bars: dict[str, SweepBar] = {}

        def watch(stage: str, progress: Progress) -> None:
            if stage not in bars:
                stack.close()
                bars[stage] = stack.enter_context(
                    SweepBar(stage, unit="tasks" if stage == STAGE else "ticks", plain=as_json)
                )
            bars[stage].watch(progress)

        found = design(request, place, scheduler=scheduler, workers=workers, watch=watch)
    files = _write(found, place, section, plot)
    ticks = _ticks(request, asked["board"])
    on_rig = [] if url is None else _on_rig(found, url, verified, confirm, place)
    if as_json:
        output.print_json(
            {**found.as_mapping(), "directory": str(place), "files": files, "on_rig": on_rig, "ticks": ticks}
        )
        return
    output.show(found.detailed())
    output.show([found.margin_table(5)])
    for text in ticks:
        output.note(text)
    click.echo(found.toml(), nl=False)
    output.print_pairs([(name, path) for name, path in files.items() if path is not None])
    name_next()


def _ticks(request: DesignRequest, board: str) -> list[str]:
    """Return notes on the processor cycles of control laws on the device, and if the experiment's law is too slow."""
    if not any(one.loop == "device" for one in request.places):
        return []
    budget, own = named_budget(board), request.experiment.controller
    found = [f"law on the device, {name}: {budget.text(name)}" for name in (INTEGERS, "fdm-butterworth")]
    if own.loop == "device" and own.position_rate > budget.rate_maximum(own.estimator):
        found.append(
            f"the experiment's own law does not fit at {own.position_rate} Hz: {budget.text(own.estimator)}"
        )
    return found


def _limits(asked: dict[str, Any]) -> list[str]:
    keys = {"felt": "verdict.felt_velocity", "heard": "verdict.heard_force", "moved": "verdict.moved"}
    return [f"{key}={asked[name]!r}" for name, key in keys.items() if asked[name] is not None]


def _wall(
    experiment: Experiment, must: bool, stiffness: float | None, damping: float | None
) -> tuple[float, float] | None:
    if not must:
        if (stiffness, damping) != (None, None):
            raise ConfigError(
                "-K and -B have no effect: they describe the wall of --must-be-stable, which is not given",
                remedy="add --must-be-stable, or drop -K and -B",
            )
        return None
    wall = {"wall.stiffness": stiffness, "wall.damping": damping}
    walled = config.override(
        experiment, {key: value for key, value in wall.items() if value is not None}
    ).wall
    if walled.stiffness == 0.0:
        raise ConfigError(
            "the stiffness -K of the wall is 0: it must be above 0", remedy="give -K a value above 0"
        )
    return walled.stiffness, walled.damping


def _places(experiment: Experiment, url: str | None, asked: dict[str, Any]) -> tuple[LawPlace, ...]:
    """Return where the control law may run (host, device), each with its limits of rate and delay.

    The limits come from the options `asked`, or from the device at `url`.
    """
    loop, names = asked["loop"], ("most_rate", "round_trip", "link")
    if url is None:
        rate, round_trip_s, link = (asked[name] for name in names)
        return places_for(
            experiment,
            loop,
            rate_maximum=rate,
            bytes_per_second=link,
            round_trip_s=round_trip_s,
            board=asked["board"],
        )
    given = [f"--{name.replace('_', '-')}" for name in names if asked[name] is not None]
    if given:
        option_name = given[0]
        raise ConfigError(
            f"{option_name} is given together with --url: the device at the URL reports this limit itself",
            remedy=f"drop {option_name}, or drop --url",
        )
    load_device(url)
    allowed = {place.loop: place for place in places_of(url, experiment, asked["board"])}
    wanted = tuple(allowed) if loop == "both" else (loop or experiment.controller.loop,)
    if not set(wanted) <= set(allowed):
        raise ConfigError(
            f"the device at {url} cannot run the control law itself",
            remedy="give --loop host, or flash a firmware that runs it",
        )
    return tuple(allowed[one] for one in wanted)


def _write(found: Design, place: Path, section: Path | None, ending: str) -> dict[str, str | None]:
    """Write the [controller] section, the numbers, the picture and the page of a design; return their paths by name."""
    write_document(place / SUMMARY, found.as_mapping())
    for path in [place / SECTION, *([] if section is None else [section])]:
        with whole_file(path, overwrite=True) as file:
            file.write(found.toml().encode())
    picture = output.drawn(found, place / f"design.{ending}") if ending else None
    png = None
    if picture is not None:
        inline = picture if ending == "png" else output.drawn(found, place / "design.png")
        png = None if inline is None else Path(inline).read_bytes()
    page = write_design_report(found, shlex.join(["rig", *sys.argv[1:]]), png, place)
    return {
        "section": str(section or place / SECTION),
        "numbers": str(place / SUMMARY),
        "picture": picture,
        "page": str(page),
    }


def _on_rig(
    found: Design, url: str, verified: bool, confirm: str | None, place: Path
) -> list[dict[str, Any]]:
    """Measure on the device which walls are stable with the recommended and with the experiment's own sampling scheme.

    Return the limits of both as plain values.
    """
    maps = []
    standings = [found.recommended] if found.recommended is found.own else [found.recommended, found.own]
    for one in (standing.candidate for standing in standings):
        experiment = one.condition(found.experiment)
        top = found.recommended.measures.damping
        plan = hit_plan(
            experiment,
            [one.scheme],
            dampings=sorted({top * n / ON_RIG_COLUMNS for n in range(ON_RIG_COLUMNS)}),
            search=search_for(experiment, "bisection", ratio=ON_RIG_RATIO, on_device=True),
            on_device=True,
        )
        _, mapped = Dialogue(plan, url, realtime=False, confirm=confirm).map(place, verified=verified)
        output.note(repr(mapped))
        maps.append(mapped.as_mapping())
    return maps
