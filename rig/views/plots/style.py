"""One look for all pictures: quiet axes, units in every label, colours that a colour-blind reader can tell apart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rig.core.deferred import agg, figures, matplotlib
from rig.core.errors import RecordingError

MEASURED = "#0072b2"
TRUE = "#e69f00"
SENT = "#d55e00"
OTHER = "#009e73"
WALL = "#999999"
BAD = "#b00020"
SERIES = (
    MEASURED,
    SENT,
    OTHER,
    TRUE,
    "#cc79a7",
    "#56b4e9",
    "#7a5195",
    "#444444",
    "#b8860b",
    "#2f4b7c",
    "#999999",
)
KINDS = {"stable": "#00703c", "limit cycle": "#b35900", "unstable": BAD, "invalid": "#666666"}
DPI = 120
RECORDINGS = (".parquet", ".rigcap")  # suffixes


def new_figure(width: float = 9.0, height: float = 7.0) -> Any:
    """Make a figure that belongs to no window."""
    figure = figures.Figure(figsize=(width, height), layout="constrained")
    agg.FigureCanvasAgg(figure)
    return figure


def tidy(axes: Any, ylabel: str) -> None:
    """Label and lighten one panel."""
    axes.set_ylabel(ylabel)
    lighten(axes)


def lighten(axes: Any) -> None:
    """Quiet grid, no box."""
    axes.grid(True, color="#e6e6e6", linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)


def save(figure: Any, path: Path) -> Path:
    """Write a PNG, or an SVG where the name ends so; the same picture gives the same bytes.

    `RecordingError` when it cannot be written, or has the name of a recording: those are never overwritten.
    """
    if path.suffix in RECORDINGS:
        raise RecordingError(
            f"{path} is not a name for a picture: recordings end like that",
            remedy="give one that ends in .png",
        )
    for text in figure.findobj(lambda artist: hasattr(artist, "set_text")):
        text.set_text(
            text.get_text().encode("utf-8", "backslashreplace").decode()
        )  # a file's name need not be text
    try:
        if path.suffix == ".svg":
            with matplotlib.rc_context({"svg.hashsalt": "haptic-rig", "svg.fonttype": "none"}):
                figure.savefig(path, format="svg", metadata={"Date": None, "Creator": None})
        else:
            figure.savefig(path, dpi=DPI, format="png", metadata={"Software": None})
    except OSError as error:
        raise RecordingError(
            f"cannot write the picture {path}: {error.strerror or error}",
            remedy="choose another place for it",
        ) from error
    return path
