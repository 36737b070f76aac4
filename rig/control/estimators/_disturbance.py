"""Disturbance observer: it knows the inertia and the effort, and estimates the hand's force, which varies slowly.

In each period T, x̂ and v̂ are predicted with the acceleration (effort + d̂)/J, where d̂ is the estimated force of the
hand and J the inertia; the error e of the predicted count then corrects all three estimates: x̂ by l1·e, v̂ by l2·e/T,
d̂/J by l3·e/T². So an acceleration by the motor is followed without delay, and one by the hand with the delay of a
third-order loop. A loop without d̂ ignores the hand: at rest under a press F it reads the velocity −2·ζ·F/(ω0·J), and
the wall's static stiffness falls to K/(1 + 2·ζ·B/(ω0·J)).

The poles are those of a third-order Butterworth filter at ω0, mapped by z = exp(s·T); the steady Kalman filter of a
triple integrator has the same poles for small ω0·T. J is the inertia of the device without the hand. A hand that holds
it firmly adds inertia, which makes the observer slower but not biased. Experiments name it ``disturbance``. Its update
must not allocate.

Source: the observer is that of Ohishi et al. (1987) in the form with an augmented state; poles by Ackermann's formula.
"""

import cmath
import math
from collections.abc import Mapping
from typing import Any

from rig.control.estimators import _kalman as kalman
from rig.control.estimators import _poles as poles
from rig.control.estimators.estimator import Estimator, Setting, check_below_nyquist


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return the parameters of the disturbance observer: gains, and the acceleration (counts/period²) per N·m or N."""
    check_below_nyquist("disturbance", "frequency_hz", settings["frequency_hz"], period_s)
    angle = 2.0 * math.pi * settings["frequency_hz"] * period_s  # ω0·T
    upper = angle * cmath.exp(2j * math.pi / 3.0)
    gains = poles.gains([complex(-angle), upper, upper.conjugate()])
    return kalman.steady_parameters(gains, period_s**2 / (settings["inertia"] * resolution))


ESTIMATOR = Estimator(
    name="disturbance",
    summary="disturbance observer: inertia and effort known, the hand an unknown force",
    source="Ohishi et al. (1987); poles of a third-order Butterworth filter",
    update=kalman.update,
    floats=kalman.SQUARES,
    ints=kalman.INTS,
    settings=(
        Setting("frequency_hz", 150.0, 0.1, 1e6, "Hz", "natural frequency ω0/2π of the observer"),
        Setting("inertia", None, 1e-12, 1e6, "kg·m² or kg", "inertia without the hand", of_rig=True),
    ),
    design=design,
    position=kalman.OFFSET,
    uses_effort=True,
)
