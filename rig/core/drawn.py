"""Results that have a picture, and what a picture is, without what draws it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture: a notebook shows it, `save` writes it, and `figure` is a `matplotlib.figure.Figure` to edit."""

    figure: Any
    write: Callable[[Any, Path], Path] = field(repr=False)  # `rig.views.plots.style.save`
    png: Callable[[Any], bytes] = field(repr=False)  # `rig.views.plots.style.png`

    def save(self, path: str | Path) -> Path:
        """Write it as PNG, SVG or PDF, as the name ends; `RecordingError` when it cannot be."""
        return self.write(self.figure, Path(path))

    def _repr_png_(self) -> bytes:
        return self.png(self.figure)


class Drawn:
    """A result that has a picture. It asks the public face for it, so that no result imports what draws."""

    __slots__ = ()

    def plot(self) -> Picture:
        """Draw it."""
        drawn: Picture = sys.modules["rig"].plot(self)
        return drawn
