"""``rig hit --compare``: the same simulated hit under several schemes, in numbers and as a picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from rig import config
from rig.cli import output
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.core.present import Table, plain
from rig.core.sample import unit_of
from rig.experiments import compare as comparing
from rig.experiments.compare import Comparison, Entry, SchemeImpacts, default_entries
from rig.experiments.plan import stands_for_device
from rig.papers.koul import compare as koul
from rig.papers.koul import impact_pictures
from rig.papers.koul.compare import Panel, Profiles, WordLength
from rig.views.plots.compare import draw_comparison

NO_DAMPING = "none"
UNUSED = ("trial.repeats", "trial.seed")  # a trial without bytes has no noise: every repeat would be the same


def refuse_a_device(url: str | None, realtime: bool, verified: bool, changes: Mapping[str, Any]) -> None:
    """Refuse what would need a link: a comparison is simulated, without bytes and without time."""
    place, _, options = (url or "sim://").partition("?")
    if realtime or verified or options or not place.startswith("sim:"):
        asked = "--realtime" if realtime else "--verified" if verified else f"--url {url}"
        raise ConfigError(
            f"--compare and {asked}: schemes are compared in simulation, where every hit starts alike",
            remedy="leave it out, or run `rig hit --rate …` once for each scheme on the device",
        )
    unused = [key for key in UNUSED if key in changes]
    if unused:
        raise ConfigError(
            f"--compare and {unused[0]}: a simulated hit without a link has nothing random in it",
            remedy="leave it out; the hits differ by the place of the encoder's edges instead",
        )


def refuse_a_verdict(expected: tuple[str, ...]) -> None:
    """Refuse an expectation: a comparison has numbers, and no verdict."""
    if expected:
        raise ConfigError(
            "--compare and --expect: a comparison has no verdict", remedy="leave one of them out"
        )


def refuse_what_is_fixed(compare: bool, as_in_the_paper: bool, chosen: object) -> None:
    """Refuse options of a comparison without --compare, and choices that the paper's conditions leave no room for."""
    if not compare:
        raise ConfigError(
            "--scheme, --cutoff and --as-in-the-paper belong to --compare", remedy="say --compare as well"
        )
    if as_in_the_paper and chosen:
        raise ConfigError(
            "--as-in-the-paper has its own rig, wall, start and schemes",
            remedy="leave the other choices out, or compare them without --as-in-the-paper",
        )


def run(
    experiment: Experiment,
    changes: Mapping[str, Any],
    schemes: Sequence[str],
    directory: Path,
    *,
    plot: str,
    as_json: bool,
) -> None:
    """Compare the schemes on the experiment under the changes; print and draw."""
    changed = config.override(experiment, changes)
    comparison = comparing.compare(changed, entries(changed, schemes))
    picture = None
    if plot:
        picture = _drawn(directory / f"{changed.rig.name}-compare.{plot}", draw_comparison, comparison)
    if as_json:
        output.print_json({**plain(comparison), "picture": picture})
        return
    motion, wall = changed.rig.motion, changed.wall
    click.echo(
        f"{changed.rig.name}: K = {wall.stiffness:g} {unit_of('stiffness', motion)}, "
        f"B = {wall.damping:g} {unit_of('damping', motion)}, the same hit, "
        f"mean over {len(comparison.outcomes[0].impacts)} encoder offsets"
    )
    output.print_table(_table(comparison))
    if comparison.cutoffs is not None:
        click.echo(f"  {comparison.cutoffs}")
    if changed.controller.loop == "device":
        click.echo(f"  {stands_for_device(changed)}")
    if picture is not None:
        output.print_pairs([("picture", picture)])


def run_as_in_the_paper(directory: Path, *, plot: str, as_json: bool) -> None:
    """Figures 7 and 8 of Koul et al.: print and draw."""
    panels, words, profiles = koul.koul_figure_7(), koul.word_lengths(), koul.koul_figure_8()
    pictures = {}
    if plot:
        pictures = {
            "figure 7": _drawn(directory / f"koul-figure-7.{plot}", impact_pictures.draw_figure_7, panels),
            "figure 8": _drawn(directory / f"koul-figure-8.{plot}", impact_pictures.draw_figure_8, profiles),
        }
    if as_json:
        output.print_json(
            {
                "figure_7": panels,
                "word_lengths": words,
                "figure_8": profiles,
                "pictures": pictures,
            }
        )
        return
    output.show([_figure_7(panels), _word_lengths(words), _figure_8(profiles)])
    output.print_pairs([(name, path) for name, path in pictures.items() if path is not None])


def entries(experiment: Experiment, schemes: Sequence[str]) -> tuple[Entry, ...]:
    """Entries of the schemes named on the command line; none, uniform and dual-rate when there are none."""
    usual = default_entries(experiment)
    if not schemes:
        return usual
    if len(set(schemes)) < len(schemes):
        raise ConfigError("a scheme is named twice", remedy="name each once")
    return tuple(
        usual[0] if text == NO_DAMPING else Entry(name=text, scheme=Scheme.parse(text)) for text in schemes
    )


def _drawn(path: Path, draw: Callable[[Any, Path], Path], what: Any) -> str | None:
    path.parent.mkdir(parents=True, exist_ok=True)
    return output.drawn(lambda: draw(what, path))


def _table(comparison: Comparison) -> Table:
    velocity = unit_of("velocity", comparison.motion)
    head = (
        "counts",
        f"impact ({velocity})",
        "peak",
        "of offsets",
        "second",
        "rest",
        "bounces",
        "decay",
        "settling (s)",
    )
    return Table(head, [_row(outcome) for outcome in comparison.outcomes])


def _row(outcome: SchemeImpacts) -> tuple[str, ...]:
    n, (least, most) = outcome.numbers, outcome.peaks
    return (
        outcome.label + ("" if outcome.complete else ", ended by the guard"),
        f"{n.impact_velocity:.3g}",
        f"{n.peak:.2f}",
        f"{least:.4g}…{most:.4g}",
        "none" if n.second_peak is None else f"{n.second_peak:.2f}",
        f"{n.rest:.2f}",
        f"{n.bounces:.3g}",
        f"{n.decay:.2f}",
        "never" if n.settling_s is None else f"{n.settling_s:.3g}",
    )


def _figure_7(panels: Sequence[Panel]) -> Table:
    rows = []
    for panel in panels:
        outcomes = zip(panel.peaks, panel.comparison.outcomes, strict=True)
        cells = [f"{peak:.2f} ({one.peaks[0]:g}…{one.peaks[1]:g})" for peak, one in outcomes]
        rows.append((f"{panel.arithmetic}, {panel.position_rate / 1e3:g} kHz", *cells))
    caption = "figure 7: peak penetration (counts), mean over the encoder offsets (least…largest)"
    return Table(("", "no damping", "uniform", "dual-rate"), rows, caption)


def _word_lengths(words: Sequence[WordLength]) -> Table:
    rates = list(words[0].none)
    rows = [
        (
            f"{row.state_bits}{' *' if row.as_in_the_paper else ''}",
            f"fs/{1 / row.uniform_share:g}",
            *(f"{row.none[r]:.4g} / {row.uniform[r]:.4g} / {row.dual[r]:.4g}" for r in rates),
        )
        for row in words
    ]
    caption = "the same for word lengths: none / uniform / dual-rate; * as in the paper"
    return Table(("state bits", "cut-off", *(f"{rate / 1e3:g} kHz" for rate in rates)), rows, caption)


def _figure_8(profiles: Profiles) -> Table:
    rows = [
        (
            f"{p.arithmetic}, {p.velocity_rate / 1e3:g} kHz",
            "–" if p.delay_s is None else f"{1e3 * p.delay_s:.3f}",
            f"{p.noise_early:.3g}",
            f"{p.noise_late:.3g}",
            f"{100 * p.reading_early:.3g}",
            f"{100 * p.reading_late:.3g}",
        )
        for p in profiles.profiles
    ]
    caption = (
        f"figure 8: velocity after the impact, early ({profiles.speed_early:.2g} rad/s rms) "
        f"and late ({profiles.speed_late:.2g} rad/s rms)"
    )
    head = ("", "delay (ms)", "off, early (rad/s)", "off, late (rad/s)", "read, early (%)", "read, late (%)")
    return Table(head, rows, caption)
