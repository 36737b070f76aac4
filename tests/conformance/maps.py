"""A small map plan for tests that use a map."""

from rig import config
from rig.config import presets
from rig.config.schemes import Scheme
from rig.experiments.mapping._searches import StiffnessSearch
from rig.experiments.mapping.zwidth import MapPlan

SHORT = {"trial.duration_s": 0.3, "verdict.tail_s": 0.1, "homing.settle_s": 0.02}


def short_map(*offsets: float) -> MapPlan:
    """Return a plan of two dampings with these encoder offsets (fractions of a count)."""
    return MapPlan(
        experiment=config.override(presets.load("koul-compliant"), SHORT),
        schemes=(Scheme.parse("uniform:20k"),),
        dampings=(0.0, 0.3),
        search=StiffnessSearch(lowest=10.0, highest=100.0, ratio=3.0),
        offsets=offsets,
    )
