"""The virtual wall: a unilateral spring and damper.

τ = K·θ + B·ω inside, zero outside (Koul et al., equation (1)). In dual-rate rendering θ is the position of this tick
and ω the velocity held since the last velocity sample; `rig.control.step` selects both. Experiments select it by
``wall.law``; `rig.control.step` calls it in each tick. It must not allocate.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.control.law import Law
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_CLAMPED, LAW_SIGNATURE

Floats = NDArray[np.float64]

STIFFNESS, DAMPING, MAY_PULL, ENTRY_ONLY = range(4)  # parameters
PARAMETERS = 4
STATE = 1  # only `LAW_CLAMPED`: 1 when this tick's reaction was clamped


@kernel(LAW_SIGNATURE)
def spring_damper(
    penetration: float, penetration_velocity: float, elapsed_ticks: int, state: Floats, parameters: Floats
) -> float:
    """Return the reaction of the virtual wall (N·m or N), positive towards free space.

    Parameters
    ----------
    penetration
        Depth inside the wall (rad or m); the wall exists only for values above zero.
    penetration_velocity
        Estimated rate of the penetration (rad/s or m/s), positive inwards.
    parameters
        K (N·m/rad or N/m), B (N·m·s/rad or N·s/m), 1 if the wall may pull, 1 if damping acts on entry only.
    """
    state[LAW_CLAMPED] = 0.0
    if penetration <= 0.0:
        return 0.0
    velocity = penetration_velocity
    # Options, because the papers do not define them: whether damping acts on the way out, and whether the wall may pull
    # a handle that leaves it faster than K·θ/B.
    if parameters[ENTRY_ONLY] != 0.0 and velocity < 0.0:
        velocity = 0.0
    reaction = parameters[STIFFNESS] * penetration + parameters[DAMPING] * velocity
    if reaction < 0.0 and parameters[MAY_PULL] == 0.0:
        state[LAW_CLAMPED] = 1.0
        return 0.0
    return float(reaction)


def spring_damper_law() -> Law:
    """Return the law of the virtual wall: a spring and a damper that act only inside the wall."""
    return Law("spring-damper", "unilateral spring and damper", spring_damper, STATE, design)


def design(wall: Mapping[str, Any]) -> list[float]:
    """Return a wall's parameters: K, B, 1 (else 0) if the wall may pull, 1 (else 0) if only entry is damped."""
    may_pull = 1.0 if wall["pull"] == "allow" else 0.0
    entry_only = 1.0 if wall["damping_on"] == "entry" else 0.0
    return [wall["stiffness"], wall["damping"], may_pull, entry_only]
