"""Helpers of the tests of pictures: checks of axes, and figures captured instead of saved."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.views.plots import style


@style.own_style()
def a_figure(title: str = "K_max (N·m/rad)") -> Any:
    figure = style.new_figure(3.0, 2.0)
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [2.0, 1.0], label="a curve")
    axes.set_title(title)
    return figure


def check_axes(figure: Any) -> Any:
    """Check that each axis has finite limits and fewer than 200 ticks, and return the figure."""
    # Data that cannot be drawn fail here already; drawing them would take ten times as long.
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = axis.get_view_interval()
            assert np.isfinite([low, high]).all()
            assert low != high
            assert len(axis.get_majorticklocs()) + len(axis.get_minorticklocs()) < 200
    return figure


@pytest.fixture
def composed(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Intercept `style.save`; return the list of figures passed to it, each with checked axes."""
    figures: list[Any] = []

    def save(figure: Any, path: Path) -> Path:
        figures.append(check_axes(figure))
        return path

    monkeypatch.setattr(style, "save", save)
    return figures
