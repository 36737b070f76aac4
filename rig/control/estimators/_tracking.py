"""Tracking loop of second order (type 2), which motor drives use for encoders and resolvers.

Two integrators follow the counts: x̂ ← x̂ + v̂·T + l1·e, v̂ ← v̂ + l2·e/T, with e the count minus its
prediction. Constant velocity is followed without lag, an acceleration a with the velocity error 2·ζ·a/ω0. The
continuous loop s² + 2·ζ·ω0·s + ω0² is mapped by its poles, z = exp(s·T). With l2 = 2·(2 − l1) − 4·√(1 − l1) it is the
steady Kalman filter of a double integrator (Kalata 1984, "The tracking index"): ζ → 1/√2 as ω0·T → 0, and for any gains
of `kalman` with ``model = "double"`` there are ω0 and ζ that give the same gains. Experiments name it ``tracking``. Its
update must not allocate.

Source: phase-locked loop of a drive, as in Ellis, *Control System Design Guide*, chapter on observers.
"""

import cmath
import math
from collections.abc import Mapping
from typing import Any

from rig.control.estimators import _kalman as kalman
from rig.control.estimators import _poles as poles
from rig.control.estimators.estimator import Estimator, Setting, check_below_nyquist


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return the gains of the tracking loop for position and velocity (counts, periods) as its parameters."""
    check_below_nyquist("tracking", "frequency_hz", settings["frequency_hz"], period_s)
    angle, ratio = 2.0 * math.pi * settings["frequency_hz"] * period_s, settings["damping"]  # ω0·T, ζ
    root = cmath.sqrt(complex(ratio * ratio - 1.0))
    return kalman.steady_parameters(poles.gains([angle * (-ratio + root), angle * (-ratio - root)]))


ESTIMATOR = Estimator(
    name="tracking",
    summary="tracking loop of two integrators, as motor drives use it",
    source="Ellis, Control System Design Guide; Kalata (1984) for the equal Kalman filter",
    update=kalman.update,
    floats=kalman.SQUARES,
    ints=kalman.INTS,
    settings=(
        Setting("frequency_hz", 200.0, 0.1, 1e6, "Hz", "natural frequency ω0/2π of the loop"),
        Setting("damping", 0.5**0.5, 0.1, 10.0, "1", "damping ratio ζ of the loop"),
    ),
    design=design,
    position=kalman.OFFSET,
)
