"""Compute the fraction of a wall's damping that remains below the effort limit during slow motion.

Maps and designs call this module, and ignore a wall of which less than 80 % of the damping remains. A single
encoder count appears as a high velocity, so that B times this velocity may exceed the effort limit.
"""

import numpy as np

from rig.config import Experiment
from rig.config.velocity_reading import pulse_of_count

# A wall counts as rendered if at least this fraction of B remains below the effort limit.
RENDERED = 0.8


def rendered_share(experiment: Experiment, damping: float) -> float:
    """Return the fraction (0 to 1) of a wall's damping effort that the effort limit leaves in motion by single counts.

    `damping` is B of the wall (N·m·s/rad or N·s/m), instead of that of the experiment's wall.
    """
    # Each count appears in the estimated velocity as a pulse with the area of one count. The damper multiplies it by B,
    # and the effort limit cuts its top: with an unfiltered difference the rendered B is at most limit·T/Δ. Delay
    # and hold are left out, because they do not lower the damping in slow motion.
    asked = damping * pulse_of_count(experiment)
    if not asked.sum() > 0.0:
        return 1.0
    limit = experiment.rig.limits.effort
    return float(np.clip(asked, -limit, limit).sum() / asked.sum())
