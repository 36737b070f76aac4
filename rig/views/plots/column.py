"""Draw one column of a recording over time."""

from typing import Any

from rig.recording.data import Column
from rig.views.plots import style


@style.own_style()
def column_figure(column: Column) -> Any:
    """Return the matplotlib figure of one column of a recording over time (s)."""
    figure = style.new_figure(height=3.5)
    axes = figure.subplots()
    shown = style.visible(column.values)
    axes.plot(column.time_s[shown], column.values[shown], color=style.MEASURED, linewidth=0.9)
    axes.set_xlabel("time (s)")
    axes.set_title(column.description, fontsize=9)
    style.tidy(axes, f"{column.name} ({column.unit})")
    return figure
