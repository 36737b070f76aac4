"""Figures of results that need more data than the result itself (a recording, theory); ``table.json`` registers them.

`rig.core.shown` calls them. They must not compute results that the command does not print.
"""

from typing import Any

from rig.experiments.hits.hit import HitResult
from rig.experiments.mapping.impedance import ImpedanceResult
from rig.experiments.mapping.interface import (
    FrequencyMap,
    KMax,
    ZWidth,
    kmax_theory,
    linear_curves,
    theory_curves,
)
from rig.views.plots._zwidth_frequency import frequency_figure
from rig.views.plots.hit import hit_figure
from rig.views.plots.impedance import impedance_figure
from rig.views.plots.zwidth import kmax_figure, zwidth_figure


def hit_result_figure(result: HitResult) -> Any:
    """Return the matplotlib figure of a wall hit, drawn from its recording."""
    return hit_figure(result.recording)


def impedance_result_figure(result: ImpedanceResult) -> Any:
    """Return the matplotlib figure of a single measured impedance."""
    return impedance_figure([result])


def zwidth_with_theory_figure(found: ZWidth) -> Any:
    """Return the figure of a Z-width map (stable walls), with the linear stability limits of its sampling schemes."""
    return zwidth_figure(found, theory=theory_curves(found.plan))


def kmax_with_theory_figure(found: KMax) -> Any:
    """Return the figure of the largest stable stiffness of an undamped wall over the sampling rate, with theory."""
    return kmax_figure(found, theory=kmax_theory(found))


def frequency_with_theory_figure(found: FrequencyMap) -> Any:
    """Return the figure of a map of passive walls, with the limits of its sampling schemes by linear theory."""
    return frequency_figure(found, theory=linear_curves(found.plan))
