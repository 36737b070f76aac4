"""Compute how much of a wall's damping reaches the handle where a single encoder count reads as a high velocity.

Maps and designs count no wall whose damping is not rendered.
"""

from __future__ import annotations

import numpy as np

from rig.config import Experiment
from rig.config.velocity_reading import pulse_of_count

RENDERED = 0.8  # share of B from which on a wall counts as rendered
_BISECTIONS = 40


def rendered_share(experiment: Experiment, damping: float) -> float:
    """Return the share of B·velocity that the effort limit leaves of a slow motion, one count at a time; 1 at B = 0.

    Parameters
    ----------
    experiment
        Estimator, velocity rate, encoder and limit; its own damping does not matter.
    damping
        B of the wall (N·m·s/rad or N·s/m).
    """
    # The estimate makes a pulse of each count, whose area over time is the count. The damper multiplies it by B, and
    # what lies above the effort limit is cut off: of an unfiltered difference at most limit·T/Δ is left of any B. Delay
    # and hold are not part of it: they lower no damping that a slow hand feels.
    asked = damping * pulse_of_count(experiment)
    if not asked.sum() > 0.0:
        return 1.0
    limit = experiment.rig.limits.effort
    return float(np.clip(asked, -limit, limit).sum() / asked.sum())


def rendered_damping(experiment: Experiment) -> float:
    """Return the largest B of which at least `RENDERED` is rendered; inf if any is."""
    high = 1.0
    while rendered_share(experiment, high) >= RENDERED:
        high *= 2.0
        # No limit cuts anything: the search would double for ever.
        if high > 1e12:
            return float("inf")
    low = 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rendered_share(experiment, middle) >= RENDERED else (low, middle)
    return low
