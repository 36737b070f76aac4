"""Print figures 7 and 8 of Koul et al.: single impacts without damping, and with uniform and dual-rate sampling."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rig.cli import output
from rig.core.present import Table
from rig.experiments.trials.results import make_directory
from rig.extras.papers.koul import compare as koul
from rig.extras.papers.koul import impact_pictures
from rig.extras.papers.koul.compare import Panel, Profiles, WordLength


def show_impacts(directory: Path, *, plot: str, as_json: bool) -> None:
    """Compute, print and draw figures 7 and 8 of Koul et al.; `plot` is the ending of the pictures, empty for none."""
    panels, words, profiles = koul.koul_figure_7(), koul.word_lengths(), koul.koul_figure_8()
    pictures = {}
    if plot:
        pictures = {
            "figure 7": _draw(directory / f"koul-figure-7.{plot}", impact_pictures.draw_figure_7, panels),
            "figure 8": _draw(directory / f"koul-figure-8.{plot}", impact_pictures.draw_figure_8, profiles),
        }
    if as_json:
        output.print_json(
            {"figure_7": panels, "word_lengths": words, "figure_8": profiles, "pictures": pictures}
        )
        return
    output.show([_figure_7(panels), _word_lengths(words), _figure_8(profiles)])
    output.print_pairs([(name, path) for name, path in pictures.items() if path is not None])


def _draw(path: Path, draw: Callable[[Any, Path], Path], what: Any) -> str | None:
    make_directory(path.parent)
    return output.drawn_by(lambda: draw(what, path))


def _figure_7(panels: Sequence[Panel]) -> Table:
    rows = []
    for panel in panels:
        outcomes = zip(panel.peaks, panel.comparison.outcomes, strict=True)
        cells = []
        for peak, outcome in outcomes:
            least, largest = outcome.peaks
            cells.append(f"{peak:.2f} ({least:g}…{largest:g})")
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
            f"{one.arithmetic}, {one.velocity_rate / 1e3:g} kHz",
            "–" if one.delay_s is None else f"{1e3 * one.delay_s:.3f}",
            f"{one.noise_early:.3g}",
            f"{one.noise_late:.3g}",
            f"{100 * one.reading_early:.3g}",
            f"{100 * one.reading_late:.3g}",
        )
        for one in profiles.profiles
    ]
    caption = (
        f"figure 8: velocity after the impact, early ({profiles.speed_early:.2g} rad/s rms) "
        f"and late ({profiles.speed_late:.2g} rad/s rms)"
    )
    head = ("", "delay (ms)", "off, early (rad/s)", "off, late (rad/s)", "read, early (%)", "read, late (%)")
    return Table(head, rows, caption)
