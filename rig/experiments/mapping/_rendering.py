"""Compute the fraction of a wall's damping that remains below the effort limit during slow motion.

Maps and designs call this module, and ignore a wall of which less than `RENDERED` of the damping remains. A single
encoder count appears as a high velocity, so that B times this velocity may exceed the effort limit.
"""

from __future__ import annotations

import numpy as np

from rig.config import Experiment
from rig.config.velocity_reading import pulse_of_count

RENDERED = 0.8  # share of B from which on a wall counts as rendered
_BISECTIONS = 40


def rendered_share(experiment: Experiment, damping: float) -> float:
    """Return the fraction of B·velocity that remains below the effort limit in a slow motion of single counts (0 to 1).

    Parameters
    ----------
    experiment
        Estimator, velocity rate, encoder and effort limit; the damping of its wall is ignored.
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
    """Return the largest B of which at least 80 % is rendered (N·m·s/rad or N·s/m); inf without an upper bound."""
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
