"""Helpers of the tests of pictures: a figure, and checks of axes."""

from typing import Any

import numpy as np

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
