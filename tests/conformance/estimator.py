"""Known limits of the built-in estimators: arguments of `rig.testing.check_estimator` by name."""

from typing import Any

# Settings without a default, which an experiment takes from its rig.
REQUIRED: dict[str, dict[str, float | str]] = {"disturbance": {"inertia": 0.5}}

KNOWN_LIMITS: dict[str, dict[str, Any]] = {
    "fdm-butterworth-fixed": {"linear": False},  # it rounds
    "period": {"linear": False},  # going back over an edge is no distance, whatever counts say
    "period-frequency": {"linear": False},
    "foaw-end": {"linear": False},  # its noise band is a number of counts
    "foaw-best": {"linear": False},
    "levant": {"linear": False},  # its gains are an acceleration: scale C with the motion
    "foaw-levant": {"linear": False},
    "optimal": {"linear": False},
    "disturbance": {"settings": REQUIRED["disturbance"]},
}
