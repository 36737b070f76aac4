"""Figures of results that need more than the result, for the table of this room (``rig/views/table.json``).

`rig.core.shown` calls them. They must not compute what a command would not print.
"""

from __future__ import annotations

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
    """Draw the recording of a hit."""
    return hit_figure(result.recording)


def impedance_result_figure(result: ImpedanceResult) -> Any:
    """Draw one impedance in a figure of its own."""
    return impedance_figure([result])


def zwidth_with_theory_figure(found: ZWidth) -> Any:
    """Draw a map with the linear limits of its schemes."""
    return zwidth_figure(found, theory=theory_curves(found.plan))


def kmax_with_theory_figure(found: KMax) -> Any:
    """Draw the limits at B = 0 over the rate with those of linear theory."""
    return kmax_figure(found, theory=kmax_theory(found))


def frequency_with_theory_figure(found: FrequencyMap) -> Any:
    """Draw a map with the linear limits of its schemes."""
    return frequency_figure(found, theory=linear_curves(found.plan))
