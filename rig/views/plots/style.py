"""Common style of all pictures: light axes, units in each label, colours that colour-blind readers can distinguish.

All figures of the package and of its extras use it. It must not import pyplot, a window toolkit or a result.
"""

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

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
KINDS = {"stable": "#00703c", "limit cycle": "#a85300", "unstable": BAD, "invalid": "#666666"}
DPI = 120
# A long line is drawn by its extremes in so many stretches: several for each pixel of the widest picture.
STRETCHES = 5000
_KEY_LINE = 0.18  # height of a line of a legend (inch)
# By ending how it is saved: without what would differ from one minute or version to the next.
FORMATS: Mapping[str, Mapping[str, Any]] = {
    # Level 3: a tenth larger than the usual 6, and a third faster.
    "png": {"metadata": {"Software": None}, "pil_kwargs": {"compress_level": 3}},
    "svg": {"metadata": {"Date": None, "Creator": None}},
    "pdf": {"metadata": {"CreationDate": None, "Creator": None, "Producer": None}},
}
# matplotlib's settings are global: of two overlapping contexts, one would leave its settings behind.
_settings_lock = threading.RLock()
_AS_TEXT = {"svg.hashsalt": "haptic-rig", "svg.fonttype": "none", "pdf.fonttype": 42}


@contextmanager
def own_style() -> Iterator[None]:
    """Use matplotlib's default settings within the context; ignore the user's matplotlibrc, style and LaTeX.

    Texts and ticks read their settings when they are created, so each call of `new_figure` must be inside the context.
    Also usable as a decorator. Raise `RecordingError` if matplotlib cannot be imported.
    """
    with _settings_lock:
        try:
            settings = matplotlib.rc_context()
        except (ImportError, ValueError) as error:  # of a backend in MPLBACKEND that is not installed here
            raise RecordingError(
                f"matplotlib cannot be imported: {error}", remedy="unset MPLBACKEND, or reinstall matplotlib"
            ) from error
        with settings:
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(_AS_TEXT)
            yield


def new_figure(width: float = 9.0, height: float = 7.0) -> Any:
    """Return a new matplotlib figure that belongs to no window; `width` and `height` are in inches."""
    figure = figures.Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    agg.FigureCanvasAgg(figure)
    return figure


def tidy(axes: Any, ylabel: str) -> None:
    """Label the vertical axis of a panel, draw a light grid, and hide the top and right border of the panel."""
    axes.set_ylabel(ylabel)
    lighten(axes)


def lighten(axes: Any) -> None:
    """Draw a light grid in a panel, and hide the top and right border of the panel."""
    axes.grid(True, color="#e6e6e6", linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)


def at_least(axes: Any, which: str, span: float) -> None:
    """Widen the axis `which` (``"x"`` or ``"y"``) about its middle to a range of at least `span`."""
    low, high = getattr(axes, f"get_{which}lim")()
    more = 0.5 * (span - (high - low))
    if more > 0.0:
        axes.set(**{f"{which}lim": (low - more, high + more)})


def count_along(axes: Any) -> None:
    """Show only whole numbers at the ticks of the horizontal axis, and widen the axis to a range of at least 2."""
    at_least(axes, "x", 2.0)
    axes.xaxis.get_major_locator().set_params(integer=True, min_n_ticks=1)


def visible(*values: NDArray[Any]) -> slice | NDArray[np.int64]:
    """Return the indices of points that suffice to draw long lines.

    The points are minimum and maximum of each line in each of `STRETCHES` stretches; short lines are drawn completely.
    """
    size = len(values[0])
    rows = size // STRETCHES
    if rows <= 2 * len(values):
        return slice(None)
    whole = size // rows * rows
    starts, chosen = np.arange(0, whole, rows), [np.array([0, size - 1])]
    for line in values:
        stretches = line[:whole].reshape(-1, rows)
        chosen += [starts + stretches.argmin(axis=1), starts + stretches.argmax(axis=1)]
    return np.unique(np.concatenate(chosen))


def say(axes: Any, text: str) -> None:
    """Write a text into the middle of a panel, such as the reason why the panel is empty, and remove its ticks."""
    look = {"ha": "center", "va": "center", "color": "#666666", "fontsize": 8, "bbox": {"color": "white"}}
    axes.text(0.5, 0.5, text, transform=axes.transAxes, **look)
    axes.set(xticks=[], yticks=[])


def key_below(figure: Any, axes: Any) -> None:
    """Put the legend of a panel below all panels, in as many columns as fit into the figure's width."""
    handles, labels = axes.get_legend_handles_labels()
    for columns in range(len(handles), 0, -1):
        key = figure.legend(
            handles, labels, loc="outside lower center", ncols=columns, fontsize=8, frameon=False
        )
        if columns == 1 or key.get_window_extent(figure.canvas.get_renderer()).width < figure.bbox.width:
            break
        key.remove()
    if handles:
        figure.set_figheight(figure.get_figheight() + _KEY_LINE * -(-len(handles) // columns))


def save(figure: Any, path: Path) -> Path:
    """Write a figure to a file and return its path; the ending of the path selects the format, one of `FORMATS`.

    Equal figures give equal bytes. Raise `RecordingError` if the file cannot be written, or for another ending, so that
    no recording is overwritten.
    """
    ending = path.suffix.lower().removeprefix(".")
    if ending not in FORMATS:
        raise RecordingError(
            f"{path} does not end in a format of pictures, such as .png",
            remedy=f"give a name that ends in one of: {', '.join('.' + known for known in FORMATS)}",
        )
    try:
        _write(figure, path, ending)
    except OSError as error:
        raise RecordingError(
            f"cannot write the picture {path}: {error.strerror or error}",
            remedy="choose another path for the picture",
        ) from error
    return path


def png(figure: Any) -> bytes:
    """Return a figure as the bytes of a PNG file, for a notebook."""
    buffer = BytesIO()
    _write(figure, buffer, "png")
    return buffer.getvalue()


@own_style()
def _write(figure: Any, target: Path | BinaryIO, ending: str) -> None:
    for text in figure.findobj(lambda artist: hasattr(artist, "set_text")):
        # A file's name need not be valid UTF-8.
        text.set_text(text.get_text().encode("utf-8", "backslashreplace").decode())
    layout = figure.get_layout_engine()
    try:
        if layout is not None:
            layout.execute(figure)
        # Else all is drawn once more, in vain, for the sake of the layout: also with "none", which stands for it.
        figure.set_layout_engine(None)
        figure.savefig(target, dpi=DPI, format=ending, **FORMATS[ending])
    finally:
        figure.set_layout_engine(layout)
