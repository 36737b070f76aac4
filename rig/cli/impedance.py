"""The command ``rig impedance measure``: excite a rig about a wall, and judge passivity and fidelity.

`rig.experiments.mapping.impedance` measures and judges; this file parses options and prints.
"""

import math
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from rig.analysis.impedance import EFFECTIVE_LINES, Fidelity
from rig.cli import options, output
from rig.cli._keyword_options import gathered_options, keyword_options
from rig.cli.command import command, option
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError, GuardError
from rig.core.sample import unit_of
from rig.experiments.mapping import impedance as measuring
from rig.experiments.mapping.impedance import ImpedanceResult, Judging, OnDevice, Wall, numbers_of
from rig.experiments.trials.plan import STANDS_FOR_DEVICE
from rig.experiments.trials.settings import ExcitationSettings
from rig.views.plots.impedance import draw_impedance

CONFIRM = ("each", "no")


@command()
@options.file_argument
@options.rig_option(options.EXCITED_PRESET)
@options.walls_options(
    "Stiffness of the walls. [the experiment's, and the bare rig]",
    "Damping of the walls: one value for each stiffness, or one for all.",
)
@options.scheme_option("the experiment's")
@options.set_option
@option("--bare", is_flag=True, help="Also measure the rig without a wall (alone, if no wall is given).")
@option(
    "--method",
    type=click.Choice(["periodic", "welch"]),
    default="periodic",
    show_default=True,
    help="Method of estimating the spectra.",
)
@options.judge_option
@keyword_options(ExcitationSettings)
@gathered_options(Judging, "judging")
@options.url_option("simulate, with an actuator beside the motor")
@options.realtime_option("A simulated device (sim://) as a process, in real time.")
@options.verified_option
@options.arm_anyway_option
@options.confirm_option(CONFIRM, "each run; no for a simulated device")
@options.output_option("impedances", "Directory of tables and picture.", "directory")
@options.plot_options("Draw magnitude, phase and real part.")
@options.expect_option(("passive", "not-passive"))
@options.json_option
def measure(
    judging: Judging,
    stiffness: str | None,
    damping: str | None,
    bare: bool,
    schemes: tuple[str, ...],
    judged: str | None,
    method: Any,
    url: str | None,
    realtime: bool,
    verified: bool,
    arm_anyway: bool,
    confirm: str | None,
    directory: Path,
    plot: str,
    expected: tuple[str, ...],
    as_json: bool,
    **rig: Any,
) -> None:
    """Measure the impedance that a rig renders: excite it about a wall, and judge passivity and fidelity line by line.

    A line is a frequency of the excitation. Without arguments: the bare rig chawda-linear and its wall, simulated, as
    in Fig. 4 and Fig. 6 of Chawda et al. With --url the rig's own motor excites it, and every run is recorded.
    """
    experiment = options.excited_experiment(url=url, **rig)
    walls = _walls(experiment, stiffness, damping, bare)
    signal: Any = "truth" if judged == "true" else "count"
    parsed = tuple(Scheme.parse(text) for text in schemes)
    place = directory / f"{experiment.rig.name}-{datetime.now():%Y%m%d-%H%M%S}"
    device = None
    if url is not None:
        device = OnDevice(
            url=url, recordings=place, verified=verified, realtime=realtime, arm_anyway=arm_anyway
        )
    elif realtime or verified or arm_anyway or confirm:
        raise ConfigError(
            "--realtime, --verified, --arm-anyway and --confirm need a device (--url), which is not given",
            remedy="add --url, or drop these options",
        )
    shared: dict[str, Any] = {
        "walls": walls,
        "schemes": parsed,
        "method": method,
        "judging": judging,
        "watch": _progress(as_json),
    }
    if device is None:
        results = measuring.measure_impedance(experiment, signal=signal, **shared)
    else:
        asks = confirm != "no" and not as_json and not (device.simulated and confirm is None)
        agrees = _agrees if asks else None
        results = tuple(measuring.measure_on_device(experiment, device, agrees=agrees, **shared))
    table, summary = measuring.write_results(results, place)
    measured = any(result.impedance is not None for result in results)
    picture = (
        output.drawn_by(lambda: draw_impedance(results, place / f"impedance.{plot}"))
        if plot and measured
        else None
    )
    if as_json:
        output.print_json({"results": results, "table": str(table), "picture": picture})
    else:
        _print(results)
        pairs = [("every line", str(table)), ("summary", str(summary))]
        output.print_pairs([*pairs, ("picture", picture)] if picture else pairs)
    if results and not measured:
        error = GuardError(
            f"the safety guard ended every run: {results[0].ended}",
            remedy="choose a softer wall or a smaller excitation",
        )
        error.reported = as_json
        raise error
    unexpected = measuring.unexpected(results, expected)
    if unexpected is not None:
        unexpected.reported = as_json
        raise unexpected


def _walls(experiment: Experiment, stiffness: str | None, damping: str | None, bare: bool) -> list[Wall]:
    """Return (stiffness, damping) of the walls that the options select; (0, 0) is the rig without a wall."""
    own = experiment.wall
    if stiffness is None and damping is None:
        return [(0.0, 0.0)] if bare else [(0.0, 0.0), (own.stiffness, own.damping)]
    stiffnesses = (own.stiffness,) if stiffness is None else numbers_of(stiffness, "--stiffness")
    dampings = (own.damping,) if damping is None else numbers_of(damping, "--damping")
    if len(stiffnesses) != len(dampings) and 1 not in (len(stiffnesses), len(dampings)):
        raise ConfigError(
            f"{len(stiffnesses)} stiffnesses and {len(dampings)} dampings cannot be paired",
            remedy="give the same number of stiffnesses and dampings, or a single value of one of them",
        )
    count = max(len(stiffnesses), len(dampings))
    stiffnesses, dampings = (
        values if len(values) == count else values * count for values in (stiffnesses, dampings)
    )
    walls = list(zip(stiffnesses, dampings, strict=True))
    return [(0.0, 0.0), *walls] if bare else walls


def _progress(quiet: bool) -> Any:
    if quiet or not output.on_terminal():
        return None

    def update(done: int, total: int) -> None:
        click.echo(f"\rexcited {done} of {total} times ", nl=done == total, err=True)

    return update


def _agrees(experiment: Experiment) -> bool:
    motion, wall = experiment.rig.motion, experiment.wall
    stiffness, damping = unit_of("stiffness", motion), unit_of("damping", motion)
    return click.confirm(
        f"Excite {experiment.rig.name} about a wall of {wall.stiffness:g} {stiffness}, {wall.damping:g} {damping}?",
        err=True,
    )


def _print(results: tuple[ImpedanceResult, ...]) -> None:
    for result in results:
        click.echo(click.style(result.label, bold=True))
        output.print_pairs(_pairs(result))
    if any(result.note for result in results):
        click.echo(f"  {STANDS_FOR_DEVICE}")


def _pairs(result: ImpedanceResult) -> list[tuple[str, str]]:
    experiment = result.experiment
    inertia, damping, stiffness = (
        unit_of(q, experiment.rig.motion) for q in ("inertia", "damping", "stiffness")
    )
    clipped = [("effort clipped", f"in {result.saturated:.2%} of the ticks")] if result.saturated else []
    if result.impedance is None or result.judgement is None or result.fidelity is None:
        return [(click.style("ended", fg="red"), f"after {result.ended_s:.3g} s: {result.ended}"), *clipped]
    judgement, fidelity, measured = result.judgement, result.fidelity, result.impedance
    passivity = judgement.passivity
    if judgement.passive:
        verdict = click.style("passive", fg="green", bold=True)
    elif passivity.passive:  # nothing was seen to be wrong, but not enough was seen
        verdict = click.style("not shown to be passive", fg="yellow", bold=True)
    else:
        verdict = click.style("not passive", fg="red", bold=True)
    low, high = passivity.band_hz
    pairs = [
        ("passivity", f"{verdict} over {passivity.tested} lines, {low:g} to {high:g} Hz"),
        *(("", reason) for reason in judgement.reasons),
        *_note_untested(result),
        (
            "worst line",
            f"{passivity.worst_hz:g} Hz: Re Z = {passivity.worst_real:.4g} {damping}, tolerance "
            f"{passivity.worst_tolerance:.2g}, phase {passivity.worst_phase_deg:.2f}°",
        ),
    ]
    if result.fitted is not None:
        values, doubt = result.fitted.values, result.fitted.deviations
        pairs += [
            (
                "mass" if experiment.rig.motion == "linear" else "inertia",
                _with(values["inertia"], doubt["inertia"], inertia),
            ),
            ("damping", _with(values["damping"], doubt["damping"], damping) + ", friction's share included"),
        ]
    else:
        pairs += [*_effective(fidelity, stiffness, damping), *_note_friction(result)]
    return [
        *pairs,
        ("fidelity", f"{fidelity.rms:.4g} ± {fidelity.rms_deviation:.2g} {damping} rms off the ideal wall"),
        ("coherence", f"at least {judgement.least_coherence:.3f}"),
        ("off the lines", f"{measured.residual:.2%} of the motion's power"),
        *clipped,
    ]


def _effective(fidelity: Fidelity, stiffness: str, damping: str) -> list[tuple[str, str]]:
    low, high = fidelity.effective_band_hz
    if fidelity.effective_lines < EFFECTIVE_LINES:
        text = (
            f"not computed: {fidelity.effective_lines} lines up to {high:g} Hz, at least "
            f"{EFFECTIVE_LINES} are needed"
        )
        return [("effective K, B", text)]
    lines = f"{fidelity.effective_lines} lines, {low:g} to {high:g} Hz"
    return [
        (f"effective {name}", f"{_with(value, doubt, unit, share)}, over {lines}")
        for name, value, doubt, unit, share in (
            ("K", fidelity.stiffness, fidelity.stiffness_deviation, stiffness, fidelity.stiffness_percent),
            ("B", fidelity.damping, fidelity.damping_deviation, damping, fidelity.damping_percent),
        )
    ]


def _note_friction(result: ImpedanceResult) -> list[tuple[str, str]]:
    mechanics = result.experiment.rig.mechanics
    if mechanics.motor_coulomb + mechanics.link_coulomb == 0.0:
        return []
    text = "B contains a share of friction, which ± does not cover: compare walls only with the same band and effort"
    return [("", text)]


def _note_untested(result: ImpedanceResult) -> list[tuple[str, str]]:
    if result.experiment.rig.mechanics.structure == "rigid" or result.signal == "truth":
        return []
    return [
        (
            "",
            "not tested: encoder and handle are on different masses, so the phase is not that of one "
            "point (in simulation: --judge true)",
        )
    ]


def _with(value: float, deviation: float, unit: str, percent: float = math.nan) -> str:
    asked = "" if math.isnan(percent) else f", {percent:.1f} % of the requested value"
    return f"{value:.4g} ± {deviation:.2g} {unit}{asked}"
