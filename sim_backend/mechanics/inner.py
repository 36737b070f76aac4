"""Define what the integration steps of all simulated plants share: parameters, Coulomb friction, encoder edges.

The functions must not allocate: compiled ticks call them at every integration step.
"""

import math

import numpy as np
from numba import types
from numpy.typing import NDArray

from rig.realtime.kernel import kernel
from sim_backend.mechanics.sensors import cell

Vector = NDArray[np.float64]

# Indices of `DiscretePlant.parameters`.
STEP_S = 0  # integration step (s)
STEPS = 1  # integration steps in a tick
EFFORT_LIMIT = 2  # the amplifier's saturation (N·m or N)
GRAVITY_EFFORT = 3  # weight of the end mass along the motion (N·m or N)
COULOMB = 4  # Coulomb level of the motor side, or of the whole rigid rig (N·m or N)
COULOMB_LINK = 5  # Coulomb level of the link side (N·m or N)
RESOLUTION = 6  # travel for one count (rad or m)
OFFSET = 7  # position zero within its encoder cell (count)
SIGN = 8  # direction of counting, ±1
MEAN = 9  # cogging motor: weight of a step's last effort in its mean; the first effort has the remainder
RIPPLE = 10  # cogging motor: index of the ripple's parameters, after those of the cogging
PARAMETERS = 11  # both come after these, as harmonics

_VECTOR = types.float64[::1]
_MATRIX = types.float64[:, ::1]
_FLOAT = types.float64
_INT = types.int64
ADVANCE = _INT(_VECTOR, _MATRIX, _MATRIX, _VECTOR, _FLOAT, _FLOAT)


@kernel(_FLOAT(_FLOAT, _FLOAT), inline=True)
def clip(value: float, limit: float) -> float:
    """Return a value limited to the range from −limit to +limit."""
    return math.copysign(min(abs(value), limit), value)


@kernel(types.UniTuple(_FLOAT, 2)(_FLOAT, _FLOAT, _FLOAT), inline=True)
def rub_one(free: float, gain: float, coulomb: float) -> tuple[float, float]:
    """Return the Coulomb friction on a mass (N·m or N), and the velocity of the mass after a step (rad/s or m/s).

    The velocity is exactly zero if the mass comes to rest. `free` is the velocity at the end of the step without
    friction, `gain` the change of that velocity for 1 N·m (or N) of friction, `coulomb` the largest friction (N·m or
    N).
    """
    # The quotient does not depend on the loop's variables and leaves it; a division by gain would not.
    friction = free * (-1.0 / gain)
    if abs(friction) <= coulomb:
        return friction, 0.0
    friction = clip(friction, coulomb)
    return friction, free + gain * friction


@kernel(types.UniTuple(_FLOAT, 4)(_FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT), inline=True)
def rub_both(
    free_motor: float,
    free_link: float,
    gain_motor: float,
    gain_cross: float,
    gain_link: float,
    coulomb_motor: float,
    coulomb_link: float,
) -> tuple[float, float, float, float]:
    """Return the friction on motor and on link (N·m or N), then the velocities of motor and link after a step.

    `free_…` are the velocities at the end of the step without friction, `gain_…` their change for 1 N·m (or N) of
    friction on the same mass, `gain_cross` on the other mass, `coulomb_…` the largest frictions (N·m or N). Velocities
    are in rad/s or m/s.
    """
    # The two efforts solve a box-constrained linear complementarity problem. Its gain matrix is symmetric and positive
    # definite (`plant._check_friction`), so there is exactly one solution.
    shrink = -1.0 / (gain_motor * gain_link - gain_cross * gain_cross)
    motor = shrink * (gain_link * free_motor - gain_cross * free_link)
    link = shrink * (gain_motor * free_link - gain_cross * free_motor)
    # Both masses come to rest: admissible, and therefore the solution.
    if abs(motor) <= coulomb_motor and abs(link) <= coulomb_link:
        return motor, link, 0.0, 0.0
    # Else one effort that exceeds its level lies at its level, and the other follows as for one mass.
    if abs(motor) > coulomb_motor:
        rub = clip(motor, coulomb_motor)
        rub_link, link_velocity = rub_one(free_link + gain_cross * rub, gain_link, coulomb_link)
        motor_velocity = free_motor + gain_motor * rub + gain_cross * rub_link
        if rub * motor_velocity <= 0.0:  # it opposes the motion that it leaves
            return rub, rub_link, motor_velocity, link_velocity
    rub = clip(link, coulomb_link)
    rub_motor, motor_velocity = rub_one(free_motor + gain_cross * rub, gain_motor, coulomb_motor)
    return rub_motor, rub, motor_velocity, free_link + gain_cross * rub_motor + gain_link * rub


@kernel(types.Tuple((_INT, _FLOAT))(_INT, _FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT), inline=True)
def encode(
    old: int, age: float, before: float, after: float, step_s: float, resolution: float, offset: float
) -> tuple[int, float]:
    """Return the encoder cell and the age of the last edge (s) at the end of a step.

    The step goes from position `before`, in cell `old`, to position `after`. The time of an edge is interpolated
    linearly. If the step passes several edges, only the last is used. If the step ends in the cell where it began,
    there is no edge.
    """
    new = cell(after, resolution, offset)
    if new == old:
        # `old`, not `new`: a law that runs on it need not wait for the division behind `new`.
        return old, age + step_s
    # Of several edges in a step the last counts: a counter's capture register keeps only that.
    edge = new if new > old else new + 1
    left = (after - (edge - offset) * resolution) / (after - before)
    return new, min(max(left, 0.0), 1.0) * step_s
