"""The command ``rig theory walls``: compute which walls are stable by linear theory.

`rig.analysis.theory` computes; this file parses options and prints.
"""

from pathlib import Path

import click

from rig import config
from rig.analysis.theory import (
    AtDamping,
    Bound,
    DampingLimit,
    InHand,
    PassivityBound,
    SchemeTheory,
    Theory,
    theory_of,
)
from rig.cli import options, output
from rig.cli._next_step import name_next
from rig.cli.command import EXPERIMENT, command, option
from rig.core.errors import RecordingError
from rig.core.present import plain
from rig.core.sample import unit_of

_MEANINGS = {"exact": "exact (rigid rig)"}


@command()
@options.file_argument
@options.rig_option()
@option(
    "-B",
    "--damping",
    group=EXPERIMENT,
    type=float,
    help="Wall damping to analyse, beside 0 (N·m·s/rad or N·s/m). [the experiment's]",
)
@options.scheme_option("the experiment's and the uniform ones of its rates")
@options.operator_option("Hand on the handle: none, relaxed, normal or firm. [the experiment's]")
@options.set_option
@options.output_option(".", "Directory of the picture.", "directory")
@options.plot_options("Draw K_max over B into theory-RIG.")
@options.json_option
def walls(
    file: Path | None,
    preset: str | None,
    schemes: tuple[str, ...],
    cutoff: str | None,
    operator: str | None,
    damping: float | None,
    sets: tuple[str, ...],
    directory: Path,
    plot: str,
    as_json: bool,
) -> None:
    """Compute which walls are stable on a rig by exact linear theory, and what limits their stiffness K; no simulation.

    For each scheme: the largest stable stiffness at B = 0 and at the wall's damping, the largest damping, islands of
    stability above the limit, and the conditions for passivity. Friction, quantisation and saturation are left out: on
    the papers' rigs, with their Coulomb friction, `rig zwidth -B 0` finds 1.1 to 2.5 times this K_max, without friction
    0.4 to 0.9 times; quantisation reduces the range of B by 30 to 50 %. `rig theory disagreement` maps this.
    """
    experiment = options.chosen_experiment(file, preset)
    changes = options.changes(rate=None, sets=sets, damping=damping, cutoff=cutoff)
    if changes:
        experiment = config.override(experiment, changes)
    found = theory_of(experiment, schemes or None, operator=operator)
    picture = output.drawn_by(lambda: _draw(found, directory, plot)) if plot else None
    if as_json:
        output.print_json({**plain(found), "picture": picture})
        return
    _print(found)
    if picture is not None:
        output.print_pairs([("picture", picture)])
    name_next()


def _draw(found: Theory, directory: Path, ending: str) -> Path:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError(
            f"cannot create {directory}: {error.strerror or error}", remedy="choose another --output"
        ) from error
    return found.plot().save(directory / f"theory-{found.rig}.{ending}")


def _print(found: Theory) -> None:
    damping = unit_of("damping", found.motion)
    if found.operator == "none":
        hand = f"end mass {found.end_mass:g} kg, no hand" if found.end_mass > 0.0 else "no hand"
    else:
        hand = f"{found.operator} hand (the bounds do not include it)"
    ticks = f"{found.delay_ticks} tick{'' if found.delay_ticks == 1 else 's'}"
    click.echo(
        f"{found.rig}, {hand}: damping of the rig {found.rig_damping:.4g} {damping}, "
        f"{found.drive} drive, lag {1e3 * found.lag_s:.3g} ms, set-point {1e3 * found.set_point_delay_s:.3g} ms late, "
        f"delay {ticks}; linear theory"
    )
    if found.in_hand is not None:
        click.echo(_in_hand(found.in_hand, unit_of("stiffness", found.motion)))
    for scheme in found.schemes:
        click.echo(click.style(scheme.label, bold=True))
        output.print_pairs(_pairs(found, scheme))
    for refused in found.not_linear:
        click.echo(f"{click.style(refused.label, bold=True)}: not linear: {refused.reason}")
    if found.cutoffs is not None:
        click.echo(found.cutoffs)


def _in_hand(held: InHand, unit: str) -> str:
    limits = ", ".join(f"{'above ' if limit.capped else ''}{limit.stiffness:.4g}" for limit in held.limits)
    each = " for the schemes in this order" if len(held.limits) > 1 else ""
    return f"in a {held.operator} hand the largest K at B = 0 is {limits} {unit}{each} (--operator {held.operator})"


def _pairs(found: Theory, scheme: SchemeTheory) -> list[tuple[str, str]]:
    stiffness, damping = unit_of("stiffness", found.motion), unit_of("damping", found.motion)
    pairs = [("K_max at B = 0", _limit(scheme.at_zero, stiffness)), *_bounds(scheme.at_zero)]
    if found.damping != 0.0:
        pairs += [
            (f"K_max at B = {found.damping:g}", _limit(scheme.at_wall, stiffness)),
            *_bounds(scheme.at_wall),
        ]
    return [
        *pairs,
        ("B_max", _damping_limit(scheme.damping_limit, damping, stiffness, scheme.rigid_rule)),
        ("β", _beta(scheme.at_zero.passivity)),
    ]


def _beta(passivity: PassivityBound) -> str:
    worst = passivity.rig_damping / passivity.largest_damping if passivity.largest_damping > 0.0 else 0.0
    late = f" ({worst:.3f} with lag and delay)" if abs(worst - passivity.beta) > 5e-4 and worst > 0.0 else ""
    return f"{passivity.beta:.3f}{late}: damping of the rig required per unit of B"


def _limit(at: AtDamping, unit: str) -> str:
    limit = at.limit
    if limit.capped:
        return f"above {limit.stiffness:.4g} {unit}, where the scan ended"
    if limit.stiffness > 0.0:
        text = f"{limit.stiffness:.4g} {unit}, {limit.frequency_hz:.3g} Hz there"
    else:
        text = f"none: the lowest stiffness is unstable at {limit.frequency_hz:.3g} Hz"
    for island in limit.islands:
        text += f"; island {island.low:.4g} to {'beyond ' if island.capped else ''}{island.high:.4g}"
    return text


def _bounds(at: AtDamping) -> list[tuple[str, str]]:
    binding = at.passivity.binding
    lines: dict[str, list[Bound]] = {}
    for bound in at.passivity.bounds:
        lines.setdefault(f"{bound.stiffness:.4g}", []).append(bound)
    return [_line(number, bounds, binding) for number, bounds in lines.items()]


def _line(number: str, bounds: list[Bound], binding: Bound) -> tuple[str, str]:
    first, *others = bounds
    binds = any(bound is binding for bound in bounds)
    text = f"{number}   {first.formula}, {_MEANINGS.get(first.meaning, first.meaning)}"
    text += "".join(f"; also {bound.name} ({bound.meaning})" for bound in others)
    return f"{'>' if binds else ' '} {first.name}", text + (" (binds)" if binds else "")


def _damping_limit(limit: DampingLimit, damping: str, stiffness: str, rule: float) -> str:
    if limit.capped:
        return f"above {limit.damping:.4g} {damping}, where the scan ended"
    text = (
        f"{limit.damping:.4g} {damping}, {limit.frequency_hz:.3g} Hz there (rule for a rigid rig: {rule:.3g})"
    )
    if limit.with_islands > limit.damping * (1.0 + 1e-3):
        text += f"; islands up to {limit.with_islands:.4g}, at K = {limit.island_stiffness:.4g} {stiffness}"
    return text
