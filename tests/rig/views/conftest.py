"""What the tests of pictures share."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.views.plots import style


def scaled(figure: Any) -> Any:
    """The figure, its axes with limits and ticks: there odd data are heard, and painting takes ten times as long."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = axis.get_view_interval()
            assert np.isfinite([low, high]).all()
            assert low != high
            assert len(axis.get_majorticklocs()) + len(axis.get_minorticklocs()) < 200
    return figure


@pytest.fixture
def composed(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Figures that would have been saved."""
    figures: list[Any] = []

    def save(figure: Any, path: Path) -> Path:
        figures.append(scaled(figure))
        return path

    monkeypatch.setattr(style, "save", save)
    return figures
