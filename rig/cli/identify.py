"""The command ``rig identify``: move the free handle, and identify the parameters of the rig.

`rig.experiments.identification` moves and identifies; this file parses options, asks the person, prints, and writes the
file.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from rig import Plan, format_identification
from rig.cli import options, output
from rig.cli._next_step import name_next
from rig.cli.command import EXPERIMENT, command, option
from rig.config import Experiment
from rig.core.errors import ConfigError, RecordingError
from rig.core.present import plain
from rig.core.sample import unit_of
from rig.devices import load_backend
from rig.experiments.identification import identify as identifying
from rig.experiments.identification.identify import Identification, IdentifyRequest, WeighRequest, weigh


@command()
@options.request_options(IdentifyRequest, options.free_rig_options)
@option(
    "--rate",
    "loop_rate",
    group=EXPERIMENT,
    metavar="HZ",
    help="Rate of the loop during identification (not written to the file): 1k. The excitation ends "
    "at 0.15 of this rate. [in real time: from the measured link]",
)
@option(
    "--weight",
    "mass_kg",
    type=float,
    metavar="KG",
    help="Calibrate the effort instead, by slow strokes without and with this mass (kg) hung on the "
    "rig. With --cogging: also sweep with the mass, to measure the ripple of the effort.",
)
@option("--arm", "arm_m", type=float, metavar="M", help="Lever arm of the mass. [radius of the handle]")
@option("--plan", "only_plan", is_flag=True, help="List and check the planned motions; opens no device.")
@options.output_option(None, "Experiment file to write (TOML).", "file_out")
@options.plot_options("Draw data, fit and residual.")
@options.json_option
def identify(
    request: IdentifyRequest,
    loop_rate: str | None,
    mass_kg: float | None,
    arm_m: float | None,
    file_out: Path | None,
    plot: str,
    only_plan: bool,
    as_json: bool,
) -> None:
    """Identify a rig: signs, friction, inertia, damping, delay, and the first structural mode.

    Moves the free handle, without its end mass: small pushes that stop after a few counts even if a sign is wrong, slow
    strokes at constant speeds, and excitation by random-phase multisines. FILE or --rig describes the rig as far as it
    is known; its limits of effort, speed and window are observed, and checked before anything moves. Every motion is
    recorded. Keep hands off the handle.

    With --cogging ORDER it also maps the motor's effort over position, in both directions to separate friction. The map
    needs a position zero from the encoder's index ([rig.reference]); it is written to the file ([rig.cogging]).

    With --weight it measures only effort_per_ampere, with a known mass that the operator hangs on the rig when asked.
    With --cogging and --weight it sweeps once more at the end with the mass, to measure the ripple of the motor's
    effort: a variation with position that looks like varying friction in sweeps without a mass.
    """
    if file_out is not None and file_out.exists() and file_out.is_dir():
        raise ConfigError(f"{file_out} is a directory", remedy="give the name of a file, such as rig.toml")
    load_backend(request.url or "sim://")
    if (mass_kg is not None or arm_m is not None) and (request.cogging is None or mass_kg is None):
        if mass_kg is None or only_plan or file_out is not None:
            raise ConfigError(
                "a calibration by weight needs --weight, and cannot be combined with --plan or --output",
                remedy="give --weight KG (with --arm M) without them, and copy the printed "
                "effort_per_ampere into your file",
            )
        weighing = WeighRequest(
            experiment=request.experiment,
            url=request.url,
            changes={**options.changes(loop_rate), **request.changes},
            verified=request.verified,
            output=request.output,
            mass_kg=mass_kg,
            arm_m=arm_m,
        )
        _weigh(weighing, as_json)
        return
    rate_hz = None if loop_rate is None else options.parse_rate(loop_rate)[0]
    request = replace(request, rate_hz=rate_hz, mass_kg=mass_kg, arm_m=arm_m)
    plan = _plan(request)
    if only_plan:
        if as_json:
            output.print_json(plan)
        else:
            _print_plan(plan)
        return
    found = identifying.identify(request, None if as_json else lambda text: output.note(f"  {text} …"), _ask)
    picture = _draw(found, plot) if plot else None
    written = _write(found, file_out) if file_out is not None else None
    if as_json:
        more = {"picture": picture, "file": None if written is None else str(written)}
        output.print_json({**plain(found), **more, "plan": plan})
        return
    _print(found, picture, written)
    name_next()


def _weigh(request: WeighRequest, as_json: bool) -> None:
    found = weigh(request, _ask)
    if as_json:
        output.print_json(found)
    else:
        output.show(found.rows())


def _ask(text: str) -> None:
    click.echo(f"  {text}; then press Enter", err=True)
    if not sys.stdin.readline():
        raise ConfigError("standard input ended before Enter was pressed", remedy="run it in a terminal")


def _plan(request: IdentifyRequest) -> Plan:
    return identifying.plan_of(identifying.without_end_mass(request), request)


def _print_plan(plan: Plan) -> None:
    click.echo(f"{plan.rig}: identification, {plan.duration_s:.0f} s at most, homing aside")
    output.show(plan.items())


def _draw(found: Identification, ending: str) -> str | None:
    first = found.recordings["signs"][0]
    picture = first.with_name(f"{first.name.partition('-signs')[0]}.{ending}")
    return output.drawn(found, picture)


def _write(found: Identification, path: Path) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(format_identification(found), encoding="utf-8")
    except OSError as error:
        raise RecordingError(
            f"cannot write {path}: {error.strerror or error}", remedy="choose another --output"
        ) from error
    return path


def _print(found: Identification, picture: str | None, written: Path | None) -> None:
    title = f"{found.experiment.rig.name}, identified (± 95 %: scatter and uncertainty of friction)"
    click.echo(click.style(title, bold=True))
    output.print_pairs(
        [
            *_sign_pairs(found),
            *_friction_pairs(found),
            *_cogging_pairs(found),
            *_ripple_pairs(found),
            *_dynamics_pairs(found),
        ]
    )
    for warning in found.warnings:
        click.echo(f"  {click.style('warning', fg='yellow')}  {warning}")
    pairs = [("recordings", f"{found.recordings['signs'][0].parent} ({_count(found)} files)")]
    if picture is not None:
        pairs.append(("picture", picture))
    if written is not None:
        pairs.append(("experiment", str(written)))
    output.print_pairs(pairs)
    if not found.simulated:
        click.echo("  The signs of this rig are checked: use --verified with it until the wiring changes.")


def _count(found: Identification) -> int:
    return sum(len(paths) for paths in found.recordings.values())


def _units(x: Experiment) -> dict[str, str]:
    names = ("effort", "damping", "inertia", "stiffness")
    return {name: unit_of(name, x.rig.motion) for name in names}


def _sign_pairs(found: Identification) -> list[tuple[str, str]]:
    signs, unit = found.signs, _units(found.experiment)
    return [
        ("signs", "a positive effort raises the position"),
        (
            "scale",
            f"the response to pushes shows {signs.scale:.2g} times the described inertia",
        ),
        ("breakaway", f"up {signs.breakaway_up:.3g}, down {signs.breakaway_down:.3g} {unit['effort']}"),
    ]


def _friction_pairs(found: Identification) -> list[tuple[str, str]]:
    sliding, unit = found.sliding, _units(found.experiment)
    return [
        ("Coulomb friction", sliding.coulomb.text(unit["effort"])),
        ("  up, down", f"{sliding.up.text()}, {sliding.down.text(unit['effort'])}"),
        ("  bias", sliding.bias.text(unit["effort"])),
        ("viscous damping", sliding.damping.text(unit["damping"])),
    ]


def _cogging_pairs(found: Identification) -> list[tuple[str, str]]:
    map_, unit = found.cogging, _units(found.experiment)
    if map_ is None:
        return []
    if not map_.orders:
        return [("cogging", f"no harmonic above {map_.unseen:.2g} {unit['effort']}")]
    least, most = map_.stiffness
    position = unit_of("position", found.experiment.rig.motion)
    return [
        (
            "cogging",
            f"at most {map_.peak:.3g} ± {map_.ci95:.2g} {unit['effort']}, harmonics "
            f"{', '.join(map(str, map_.orders))} of {map_.period:.4g} {position}",
        ),
        ("  from, to", f"{map_.minimum:.4g}, {map_.maximum:.4g} {position}"),
        ("  stiffness", f"{least:.3g} to {most:.3g} {unit['stiffness']}"),
        ("  friction there", map_.friction.text(unit["effort"])),
    ]


def _ripple_pairs(found: Identification) -> list[tuple[str, str]]:
    ripple = found.ripple
    if found.cogging is None:
        return []
    if ripple is None:
        return [
            (
                "ripple",
                "not separable from friction that varies with position; measure it with a mass (--weight KG)",
            )
        ]
    if not ripple.orders:
        return [("ripple", f"no harmonic above {100 * ripple.unseen:.2g} % of the effort")]
    each = zip(ripple.orders, ripple.amplitude, ripple.phase, strict=True)
    return [
        (
            "ripple" if i == 0 else "",
            f"{a.scaled(100.0).text('%')} of the effort at harmonic {n}, phase {p.text('rad')}",
        )
        for i, (n, a, p) in enumerate(each)
    ]


def _dynamics_pairs(found: Identification) -> list[tuple[str, str]]:
    dynamics, unit = found.dynamics, _units(found.experiment)
    what = "mass" if found.experiment.rig.motion == "linear" else "inertia"
    ms = dynamics.delay_s.scaled(1e3)
    pairs: list[tuple[str, str]] = [
        (what, dynamics.inertia.text(unit["inertia"])),
        (
            "delay",
            f"{ms.text('ms')}: {dynamics.delay_ticks} ticks and a lag of {dynamics.lag_s.scaled(1e3).text('ms')}",
        ),
    ]
    amplifier = found.experiment.rig.amplifier
    if amplifier.drive == "voltage":
        pairs.append(("drive", f"voltage; back-EMF as described, {amplifier.back_emf:g} {unit['damping']}"))
    mode = dynamics.mode
    if mode is None:
        highest, above = dynamics.lines_hz[-1], dynamics.mode_above_hz
        text = f"none up to {highest:g} Hz: one rigid body explains the motion as well"
        if above is not None:
            text = f"one above the band: its compliance puts an anti-resonance near {above:.3g} Hz"
        pairs.append(("mode", text))
    else:
        pairs += [
            ("mode", f"{mode.resonance_hz.text('Hz')}, damping ratio {mode.resonance_ratio.text()}"),
            ("  anti-resonance", f"{mode.antiresonance_hz.text('Hz')}"),
            ("  motor, link", f"{mode.motor_inertia.text()}, {mode.link_inertia.text(unit['inertia'])}"),
            ("  stiffness", mode.stiffness.text(unit["stiffness"])),
        ]
    coherence = _coherence(dynamics.coherence)
    return [
        *pairs,
        ("band", dynamics.band.text),
        ("coherence", coherence),
        ("unexplained", f"{100 * dynamics.unexplained:.2g} % of the motion"),
    ]


def _coherence(values: Any) -> str:
    ordered = sorted(values.tolist())
    return f"median {ordered[len(ordered) // 2]:.4f}, least {ordered[0]:.4f}, of {len(ordered)} lines"
