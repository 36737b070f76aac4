"""The picture of any result that has one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rig.analysis.theory import Theory
from rig.core.drawn import Picture
from rig.core.errors import ConfigError
from rig.experiments.compare import SchemeComparison
from rig.experiments.design import Design
from rig.experiments.disagreement import Disagreement
from rig.experiments.estimators import EstimatorComparison
from rig.experiments.hit import HitResult
from rig.experiments.identify import Identification
from rig.experiments.impedance import ImpedanceResult
from rig.experiments.ranges import linear_curves, theory_curves
from rig.experiments.replay import ReplayResult
from rig.experiments.zwidth import ZWidth
from rig.experiments.zwidth_frequency import FrequencyMap
from rig.recording.data import Column, Recording
from rig.views.plots import style
from rig.views.plots.column import column_figure
from rig.views.plots.compare import scheme_figure
from rig.views.plots.design import design_figure
from rig.views.plots.disagreement import disagreement_figure
from rig.views.plots.estimators import estimators_figure
from rig.views.plots.hit import hit_figure
from rig.views.plots.identify import identification_figure
from rig.views.plots.impedance import impedance_figure
from rig.views.plots.replay import replay_figure
from rig.views.plots.theory import theory_figure
from rig.views.plots.zwidth import zwidth_figure
from rig.views.plots.zwidth_frequency import frequency_figure


def plot(result: object) -> Picture:
    """Draw a result that has a picture, such as a hit, a recording or a column of it, a map or an impedance.

    Raises `ConfigError` for another one.
    """
    for kind, figure in _FIGURES.items():
        if isinstance(result, kind):
            return Picture(figure(result), style.save, style.png)
    raise ConfigError(
        f"a {type(result).__name__} has no picture",
        remedy="give a hit, a recording or a column of it, a replay, a comparison, a map, an impedance, an "
        "identification, a design or a theory",
    )


_FIGURES: Mapping[type, Callable[[Any], Any]] = {
    HitResult: lambda hit: hit_figure(hit.recording),
    Recording: hit_figure,
    Column: column_figure,
    ReplayResult: replay_figure,
    ZWidth: lambda found: zwidth_figure(found, theory=theory_curves(found.plan)),
    FrequencyMap: lambda found: frequency_figure(found, theory=linear_curves(found.plan)),
    Theory: theory_figure,
    Disagreement: disagreement_figure,
    Design: design_figure,
    SchemeComparison: scheme_figure,
    ImpedanceResult: lambda one: impedance_figure([one]),
    Identification: identification_figure,
    EstimatorComparison: estimators_figure,
}
