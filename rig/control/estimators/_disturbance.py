"""Disturbance observer: the rig's inertia, its known effort, and the hand as an unknown, slowly varying force.

x̂ and v̂ are carried on by the acceleration (effort + d̂)/J; the error e of the predicted count corrects all three:
x̂ by l1·e, v̂ by l2·e/T, d̂/J by l3·e/T². So the motor's part of an acceleration is followed without delay, and the hand's
with that of a loop of third order. A loop without d̂ takes the hand for nothing: pressed with F it reads
−2·ζ·F/(ω0·J) at rest, and the wall's static stiffness falls to K/(1 + 2·ζ·B/(ω0·J)).

The poles are those of a Butterworth filter of third order at ω0, mapped by z = exp(s·T), to which those of the steady
Kalman filter of a triple integrator tend. The inertia is that of the device without the hand; a hand that holds it
firmly adds to it and makes the observer slower, not biased.

Source: the observer is that of Ohishi et al. (1987) in the form with an augmented state; poles by Ackermann's formula.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from typing import Any

from rig.control.estimators import _observer as observer
from rig.control.estimators.estimator import Estimator, Setting


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Gains, and the acceleration of a unit of effort in counts per period²."""
    observer.check_frequency("disturbance", settings["frequency_hz"], period_s)
    turn = observer.turn(settings["frequency_hz"], period_s)
    swing = turn * cmath.exp(2j * math.pi / 3.0)
    poles = [complex(-turn), swing, swing.conjugate()]
    return [*observer.gains(poles), period_s**2 / (settings["inertia"] * resolution)]


ESTIMATOR = Estimator(
    name="disturbance",
    summary="disturbance observer: inertia and effort known, the hand an unknown force",
    source="Ohishi et al. (1987); poles of a third-order Butterworth filter",
    update=observer.update,
    floats=observer.FLOATS,
    ints=observer.INTS,
    settings=(
        Setting("frequency_hz", 150.0, 0.1, 1e6, "Hz", "natural frequency ω0/2π of the observer"),
        Setting("inertia", None, 1e-12, 1e6, "kg·m² or kg", "inertia without the hand", of_rig=True),
    ),
    design=design,
    position=observer.OFFSET,
    uses_effort=True,
)
