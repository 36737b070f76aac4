"""Identify a rig from its motion: sign of the effort, friction, inertia, delay, cogging and torque ripple of the motor.

`rig.experiments` calls this package with arrays of time (s), effort (N·m or N) and position (rad or m), and pictures
draw the results. Nothing here commands a device or opens a recording; poor data raise `IdentificationError`.
"""

from rig.analysis.identification._cogging import SETTLE_S, CoggingMap, fit_cogging, pairs_of
from rig.analysis.identification._dynamics import Dynamics, StructuralMode, fit_dynamics
from rig.analysis.identification._interval import Interval
from rig.analysis.identification._quality import (
    DOUBTFUL_DRIFT,
    LEAST_MOTION_COUNTS,
    MOST_DRIFT,
    IdentificationError,
    period_change,
)
from rig.analysis.identification._ripple import Ripple, fit_ripple
from rig.analysis.identification._signs import SignCheck, check_signs, stiction_warning
from rig.analysis.identification._sliding import PIECES, UNSTEADY, Sliding, Stroke, fit_sliding

__all__ = [
    "DOUBTFUL_DRIFT", "LEAST_MOTION_COUNTS", "MOST_DRIFT", "PIECES", "SETTLE_S", "UNSTEADY", "CoggingMap",
    "Dynamics", "IdentificationError", "Interval", "Ripple", "SignCheck", "Sliding", "Stroke",
    "StructuralMode", "check_signs", "fit_cogging", "fit_dynamics", "fit_ripple", "fit_sliding",
    "pairs_of", "period_change", "stiction_warning",
]  # fmt: skip
