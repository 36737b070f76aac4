"""Known limits of the built-in estimators: arguments of `rig.testing.check_estimator` by name."""

from typing import Any

# Settings without a default, which an experiment takes from its rig; 30 Hz for rates down to 1 kHz.
MASSES: Any = {"motor_inertia": 0.2, "link_inertia": 0.3, "transmission_stiffness": 2e4, "frequency_hz": 30.0}
REQUIRED: dict[str, dict[str, float | str]] = {
    "disturbance": {"inertia": 0.5},
    "disturbance-two-mass": MASSES,
}

KNOWN_LIMITS: dict[str, dict[str, Any]] = {
    "fdm-butterworth-fixed": {"linear": False},  # it rounds
    "period": {"linear": False},  # going back over an edge is no distance, whatever counts say
    "period-frequency": {"linear": False},
    "foaw-end": {"linear": False},  # its noise band is a number of counts
    "foaw-best": {"linear": False},
    "levant": {"linear": False},  # its gains are an acceleration: scale C with the motion
    "foaw-levant": {"linear": False},
    "optimal": {"linear": False},
    **{name: {"settings": settings} for name, settings in REQUIRED.items()},
}
