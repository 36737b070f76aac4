"""The commands ``rig estimators …``: list, compare on motions, tune, and export estimators as C.

`rig.experiments.estimation` computes; this file parses options, prints, and writes the results.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from rig import config
from rig.cli import _values as values
from rig.cli import options, output
from rig.cli.command import command, option
from rig.control import estimators as family
from rig.core.errors import ConfigError
from rig.core.present import Row, Table, plain
from rig.core.sample import unit_of
from rig.experiments.estimation.interface import (
    SIGNALS,
    Case,
    Score,
    Tuning,
    Variant,
    compare_estimators,
    export_estimator,
    lipschitz_of,
    recording_case,
    score,
    shown_range,
    signal_case,
    tune_estimator,
)
from rig.experiments.trials.judgement import experiment_of
from rig.recording.reader import open_recording

DEFAULT_SIGNAL = "wall-bounce"
DEFAULT_RESOLUTION = 1e-6
DEFAULT_RATES = "1k,2k,10k,20k,50k"
DEFAULT_RATE = "2k"
VARIANT_HELP = "NAME, or NAME:setting=value,setting=value."

resolution_option = option(
    "--resolution", type=float, default=DEFAULT_RESOLUTION, show_default=True, help="Resolution: m per count."
)


@command("list")
@click.argument("names", nargs=-1, type=values.ESTIMATOR)
@option("--rate", default=DEFAULT_RATE, show_default=True, help="Velocity rate at which the delay is stated.")
@options.json_option
def list_(names: tuple[str, ...], rate: str, as_json: bool) -> None:
    """List the velocity estimators (or NAMES): parameters with range, unit and meaning, delay, source."""
    hertz = _rate(rate)
    case = signal_case(SIGNALS["sine"], hertz, DEFAULT_RESOLUTION)
    facts: list[dict[str, Any]] = []
    for name in names or family.names():
        broken = "" if names else family.broken(name)
        facts.append({"name": name, "broken": broken} if broken else _facts(name, case, hertz))
    if as_json:
        output.print_json(facts)
        return
    for fact in facts:
        if "broken" in fact:
            click.echo(f"{click.style(fact['name'], bold=True)}: broken: {fact['broken']}")
            continue
        click.echo(f"{click.style(fact['name'], bold=True)}: {fact['summary']}")
        late = f"{1e3 * fact['delay_s']:.3f} ms at {fact['delay_at']}"
        if fact["refused"]:
            late = f"unknown: {fact['refused']}"
        pairs = [("delay", late), ("source", str(fact["source"]))]
        output.print_pairs([*pairs, *((p["name"], _describe(p)) for p in fact["parameters"])])


def _facts(name: str, case: Case, hertz: int) -> dict[str, Any]:
    each, scored = family.get(name), score(case, Variant(name))
    return {
        "name": name,
        "summary": each.summary,
        "source": each.source,
        "delay_s": scored.delay_s,
        "delay_at": f"{hertz} Hz, 5 Hz sine, {DEFAULT_RESOLUTION:g} m per count, default settings",
        "refused": scored.refused,
        "parameters": [_setting(s) for s in each.settings],
    }


@command()
@click.argument("recordings", nargs=-1, type=values.RECORDING)
@options.signal_option("signals", help=f"Reference signal. [{DEFAULT_SIGNAL}]", multiple=True)
@option("--rate", "rates", help=f"Velocity rates. [{DEFAULT_RATES}; of a recording: its own]")
@option(
    "--resolution",
    "resolutions",
    multiple=True,
    type=float,
    help=f"Resolution: m per count. [{DEFAULT_RESOLUTION:g}]",
)
@options.estimator_option(f"{VARIANT_HELP} [all]", names=("chosen",), multiple=True)
@option("--time/--no-time", "timed", default=True, help="Also measure the time per sample (ns).")
@options.picture_options("Draw them.", default=True, place="estimators.png")
@options.json_option
def compare(
    recordings: tuple[Path, ...],
    signals: tuple[str, ...],
    rates: str | None,
    resolutions: tuple[float, ...],
    chosen: tuple[str, ...],
    timed: bool,
    picture: options.PictureOption,
    as_json: bool,
) -> None:
    """Score estimators on reference signals and RECORDINGS: raw error, delay, error without delay, noise at rest, cost.

    All errors are rms. "at rest" is the estimated velocity after a motion has ended; "toggling" is the same while the
    count toggles at random between two neighbours.
    """
    cases = [
        _signal_case(name, rate, resolution)
        for name in signals or (() if recordings else (DEFAULT_SIGNAL,))
        for resolution in resolutions or (DEFAULT_RESOLUTION,)
        for rate in _rates(rates or DEFAULT_RATES)
    ]
    for path in recordings:
        cases += [_recording_case(path, rate) for rate in (_rates(rates) if rates else (None,))]
    comparison = compare_estimators(cases, chosen, timed=timed)
    picture.draw(Path("estimators"), lambda path: comparison.plot().save(path))
    if as_json:
        output.print_json({**plain(comparison), **picture.facts()})
        return
    names = [variant.label for variant in comparison.variants]
    for i, case in enumerate(cases):
        click.echo(_headline(case))
        _print_table(case, comparison.scores[i * len(names) : (i + 1) * len(names)], names)
    if picture.drawn is not None:
        output.print_pairs([("picture", str(picture.drawn))])


@command()
@click.argument("estimator", type=values.ESTIMATOR)
@click.argument("recording", required=False, type=values.RECORDING)
@options.signal_option(default=DEFAULT_SIGNAL, show_default=True, help="Reference signal, without RECORDING.")
@option("--rate", help=f"Velocity rate. [{DEFAULT_RATE}; of a recording: its own]")
@resolution_option
@option(
    "--objective",
    default="rms",
    show_default=True,
    help="Objective: rms, delay-corrected-rms or rms+delay; the guide explains them.",
)
@option("--free", multiple=True, help="Setting to tune. [all that have an effect]")
@options.output_option(None, "TOML to write. [NAME-tuned.toml]", "target")
@options.overwrite_option
@options.json_option
def tune(
    estimator: str,
    recording: Path | None,
    signal: str,
    rate: str | None,
    resolution: float,
    objective: str,
    free: tuple[str, ...],
    target: Path | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Find the best settings of ESTIMATOR for RECORDING or a signal, and how much each matters; write them as TOML.

    ESTIMATOR is a name, or name:setting=value,… to fix choices and to set start values. The file is a fragment of an
    experiment: put `preset = "…"` above it and run `rig hit` with it.
    """
    variant = Variant.parse(estimator)
    path = target or Path(f"{variant.estimator}-tuned.toml")
    if path.exists() and not overwrite:
        raise ConfigError(
            f"the file {path} exists already", remedy="choose another file with -o, or add --overwrite"
        )
    if recording is None:
        case = _signal_case(signal, _rate(rate or DEFAULT_RATE), resolution)
    else:
        case = _recording_case(recording, None if rate is None else _rate(rate))
    tuning = tune_estimator(
        variant.estimator, case, objective=objective, settings=variant.settings, free=free or None
    )
    path.write_text(tuning.toml(), encoding="utf-8")
    if as_json:
        output.print_json({**plain(tuning), "toml": str(path)})
        return
    click.echo(_headline(case))
    _print_tuning(tuning, case)
    output.print_pairs([("written", str(path))])


@command()
@click.argument("estimator", type=values.ESTIMATOR)
@click.argument("recording", required=False, type=values.RECORDING)
@options.rig_option("the rig of RECORDING, else koul-compliant")
@options.set_option
@options.signal_option(
    default=DEFAULT_SIGNAL, show_default=True, help="Motion of the test, without RECORDING."
)
@option(
    "--costs/--no-costs", default=True, help="Count the cycles of a call, if the cross compiler is installed."
)
@options.output_option(None, "Header to write; its test is written beside it. [NAME.h]", "target")
@options.overwrite_option
@options.json_option
def export(
    estimator: str,
    recording: Path | None,
    preset: str | None,
    sets: tuple[str, ...],
    signal: str,
    costs: bool,
    target: Path | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Write ESTIMATOR as one C99 header with the numbers that suit a rig, and a program that tests it.

    ESTIMATOR is a name, or name:setting=value,…; if the rig's file uses the same estimator, its settings apply. The
    code is the firmware's own, in float32, or in integers if the estimator exists in integers. The test contains the
    counts of RECORDING (or of a signal) and the velocities that the estimator computes from them on this computer.

    A simulator counts instructions and cycles on Cortex-M; it needs arm-none-eabi-gcc and haptic-rig[cycles].
    """
    opened = None if recording is None else open_recording(recording)
    if preset is None and opened is not None:
        experiment = experiment_of(opened)
    else:
        experiment = options.chosen_experiment(None, preset)
    experiment = config.override(experiment, options.changes(None, sets))
    case = None
    if recording is not None:
        case = _recording_case(recording, experiment.controller.velocity_rate)
    with output.StatusLine(quiet=as_json) as status:
        made = export_estimator(
            Variant.parse(estimator),
            experiment,
            target,
            case=case,
            signal=signal,
            costs=costs,
            overwrite=overwrite,
            on_progress=status.on_progress,
        )
    if as_json:
        output.print_json(made)
    else:
        output.show(made.items())


def _print_tuning(tuning: Tuning, case: Case) -> None:
    click.echo(f"{tuning.estimator}, least {tuning.objective}, {tuning.evaluations} evaluations")
    output.print_pairs(
        [
            (
                "objective",
                f"{tuning.objective_start:.4g} at the start, {tuning.objective_best:.4g} at the optimum",
            ),
            *((r.setting, f"{r.value:.4g}   (within 10 %: {shown_range(r)})") for r in tuning.ranges),
        ]
    )
    _print_table(case, [tuning.before, tuning.after], ["before", "after"])


def _setting(setting: Any) -> dict[str, Any]:
    names = ("name", "default", "of_rig", "minimum", "maximum", "unit", "choices", "meaning")
    return {name: getattr(setting, name) for name in names if hasattr(setting, name)}


def _describe(parameter: dict[str, Any]) -> str:
    if "choices" in parameter:
        return f"{parameter['default']}   ({' | '.join(parameter['choices'])}) {parameter['meaning']}"
    unit = "" if parameter["unit"] == "1" else f" {parameter['unit']}"
    default = "that of the rig, in" if parameter["of_rig"] else "must be given, in"
    if parameter["default"] is not None:
        default = f"{parameter['default']:g}"
    return f"{default}{unit}   ({parameter['minimum']:g} to {parameter['maximum']:g}) {parameter['meaning']}"


def _headline(case: Case) -> str:
    position, velocity = (unit_of(q, case.motion) for q in ("position", "velocity"))
    return (
        f"{click.style(case.name, bold=True)} at {case.rate_hz:g} Hz, {abs(case.resolution):.4g} "
        f"{position} per count; truth: {case.reference}, {case.speed_rms:.3g} {velocity} rms"
    )


def _print_table(case: Case, scores: Sequence[Score], names: Sequence[str]) -> None:
    unit = unit_of("velocity", case.motion)
    head = (
        "",
        f"error ({unit})",
        "delay (ms)",
        f"without delay ({unit})",
        f"at rest ({unit})",
        f"toggling ({unit})",
        "cost (ns)",
    )
    scored = [(name, each) for name, each in zip(names, scores, strict=True) if each.refused is None]
    output.print_table(Table(head, [(name, *_cells(each)) for name, each in scored]))
    output.print_rows([Row(n, each.refused) for n, each in zip(names, scores, strict=True) if each.refused])


def _cells(score: Score) -> list[str]:
    numbers = (
        f"{score.rms:.3g}",
        f"{1e3 * score.delay_s:.3f}",
        f"{score.rms_without_delay:.3g}",
        f"{score.rest_rms:.3g}",
        f"{score.toggling_rms:.3g}",
        f"{score.ns_per_sample:.1f}",
    )
    return ["–" if text == "nan" else text for text in numbers]


def _rate(text: str) -> int:
    rates = _rates(text)
    if len(rates) != 1:
        raise ConfigError(
            f"--rate {text}: expected a single rate, but {len(rates)} are given", remedy="write 2k or 2000"
        )
    return rates[0]


def _rates(text: str) -> list[int]:
    return [options.parse_rate(part)[-1] for part in text.split(",")]


def _signal_case(name: str, rate_hz: int, resolution: float) -> Case:
    if name not in SIGNALS:
        raise ConfigError(f"unknown signal {name!r}", remedy=f"choose one of: {', '.join(SIGNALS)}")
    if not (math.isfinite(resolution) and resolution > 0.0):
        raise ConfigError(
            f"--resolution {resolution:g} must be above 0",
            remedy="give a value above 0, in m per count, like 1e-6",
        )
    return signal_case(SIGNALS[name], rate_hz, resolution)


def _recording_case(path: Path, rate_hz: int | None) -> Case:
    return recording_case(open_recording(path), rate_hz, name=path.stem)


@command()
@click.argument("recording", type=values.RECORDING)
@option("--sines", type=click.IntRange(1, 40), default=6, show_default=True, help="Sines in the fit.")
@options.json_option
def lipschitz(recording: Path, sines: int, as_json: bool) -> None:
    """Identify C, the acceleration bound of Levant's differentiator, from RECORDING of a hit.

    C is the largest second derivative of a sum of sines that is fitted to the position around the first contact, as in
    Chawda et al. Compare with the fit with one more sine: if C changes much, a fast mode dominates and C is not known.
    """
    opened = open_recording(recording)
    fit, richer = (lipschitz_of(opened, sines=n) for n in (sines, sines + 1))
    if as_json:
        output.print_json({**plain(fit), "lipschitz_with_one_more_sine": richer.lipschitz})
        return
    position, acceleration = (unit_of(q, opened.header["motion"]) for q in ("position", "acceleration"))
    output.print_pairs(
        [
            ("C", f"{fit.lipschitz:.4g} {acceleration}   ({richer.lipschitz:.4g} with {sines + 1} sines)"),
            ("residual", f"{fit.residual_rms:.3g} {position} rms"),
            ("frequencies", ", ".join(f"{f:.3g}" for f in fit.frequencies_hz) + " Hz"),
            (
                "use it",
                f"rig hit --estimator levant --set controller.parameters.lipschitz={fit.lipschitz:.4g}",
            ),
        ]
    )
