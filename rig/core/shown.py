"""Display of a result at a Python prompt and in a notebook: a few lines (`Shown`), and a picture (`Drawn`).

Results of all packages inherit from these classes; commands and notebooks call them. A package or an extra that draws
has a table (`rig.core.extras`) with a function for each class name of a result; the function returns the figure, and is
imported when a picture is drawn. This file must not import drawing code or results. The forms of a result for commands
and pages are in `rig.core.present`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from rig.core import extras
from rig.core.check import Check
from rig.core.errors import ConfigError
from rig.core.present import Item, Row, Table

LINES, WIDTH = 10, 200  # at a prompt


class Shown:
    """Base class of results that a Python prompt shows in a few lines; a dataclass then needs ``repr=False``."""

    __slots__ = ()

    def brief(self) -> Sequence[Item]:
        """Return the most important facts of this result as a heading and rows, at most `LINES` lines."""
        raise NotImplementedError

    def detailed(self) -> Sequence[Item]:
        """Return the items (headings, rows, tables) of this result for a notebook; by default those of `brief`."""
        return self.brief()

    def __repr__(self) -> str:
        items = self.brief()
        width = max((len(item.label) for item in items if isinstance(item, Row)), default=0)
        lines = [
            f"  {item.label:<{width}}  {item.text}" if isinstance(item, Row) else str(item) for item in items
        ]
        kept = lines if len(lines) <= LINES else [*lines[: LINES - 1], "  …"]
        return "\n".join(line if len(line) <= WIDTH else f"{line[: WIDTH - 1]}…" for line in kept)

    def _repr_html_(self) -> str:
        return "".join(_html(self.detailed()))


def _html(items: Sequence[Item]) -> list[str]:
    parts, rows = [], []
    for item in [*items, ""]:
        if isinstance(item, Row):
            rows.append(f"<tr><th>{escape(item.label)}</th><td>{escape(item.text)}</td></tr>")
            continue
        if rows:
            parts.append(f"<table>{''.join(rows)}</table>")
            rows = []
        if isinstance(item, Table):
            parts.append(_table(item))
        elif isinstance(item, Check):
            parts.append(f"<p>{escape(f'{item.outcome.value}: {item.name}: {item.text}')}</p>")
        elif item:
            parts.append(f"<p><b>{escape(item)}</b></p>")
    return parts


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in table.head)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in line)}</tr>" for line in table.cells)
    caption = f"<caption>{escape(table.caption)}</caption>" if table.caption else ""
    return f"<table>{caption}<tr>{head}</tr>{body}</table>"


@dataclass(frozen=True, slots=True)
class Picture:
    """Picture that a notebook shows and `save` writes; `figure` is a `matplotlib.figure.Figure` to edit."""

    figure: Any

    def save(self, path: str | Path) -> Path:
        """Write the picture as PNG, SVG or PDF, by the suffix of `path`; raise `RecordingError` on failure."""
        written: Path = extras.load("writers", "file")(self.figure, Path(path))
        return written

    def _repr_png_(self) -> bytes:
        png: bytes = extras.load("writers", "png")(self.figure)
        return png


class Drawn:
    """Base class of results that can be drawn as a picture."""

    __slots__ = ()

    def plot(self) -> Picture:
        """Draw this result as a matplotlib figure."""
        return plot(self)


def plot(result: object) -> Picture:
    """Draw a result (hit, recording, column, map, impedance, …); raise `ConfigError` if it has no picture."""
    known = extras.added("pictures")
    for kind in type(result).__mro__:
        if issubclass(kind, Drawn) and kind.__name__ in known:
            return Picture(extras.load("pictures", kind.__name__)(result))
    raise ConfigError(
        f"a {type(result).__name__} cannot be drawn",
        remedy="give a hit, a recording or a column of it, a replay, a comparison, a map, an impedance, an "
        "identification, a design or a theory",
    )
