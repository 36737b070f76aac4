"""Results that have a picture, and what a picture is, without what draws it.

A room or an extra that draws has a table (`rig.core.extras`): under the name of a result's class stands the function
that returns its figure. It is imported when a picture is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.core import extras
from rig.core.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture: a notebook shows it, `save` writes it, and `figure` is a `matplotlib.figure.Figure` to edit."""

    figure: Any

    def save(self, path: str | Path) -> Path:
        """Write it as PNG, SVG or PDF, as the name ends; `RecordingError` when it cannot be."""
        written: Path = extras.load("writers", "file")(self.figure, Path(path))
        return written

    def _repr_png_(self) -> bytes:
        png: bytes = extras.load("writers", "png")(self.figure)
        return png


class Drawn:
    """A result that has a picture."""

    __slots__ = ()

    def plot(self) -> Picture:
        """Draw the result as a matplotlib figure."""
        return plot(self)


def plot(result: object) -> Picture:
    """Draw a result that has a picture, such as a hit, a recording or a column of it, a map or an impedance.

    Raises `ConfigError` for another one.
    """
    known = extras.added("pictures")
    for kind in type(result).__mro__:
        if issubclass(kind, Drawn) and kind.__name__ in known:
            return Picture(extras.load("pictures", kind.__name__)(result))
    raise ConfigError(
        f"a {type(result).__name__} cannot be drawn",
        remedy="give a hit, a recording or a column of it, a replay, a comparison, a map, an impedance, an "
        "identification, a design or a theory",
    )
