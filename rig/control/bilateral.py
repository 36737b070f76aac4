"""Linear laws (spring and damper on both sides of a point), as a base for measurements of impedance.

A wall that acts on one side only is not linear, so impedance is measured about a point inside a wall that also pulls.
One law adds an excitation by the rig's own motor: one period of efforts in the law's parameters, played by elapsed
ticks and not by a clock, so that the same law runs in a simulation, over the byte link, in real time and in a replay.
Another law begins at the first contact.

Measurements of impedance and identification of `rig.experiments`, the reproductions of papers and the simulation use
it. Kernels here must not allocate, and must not depend on the link to the device.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import types
from numpy.typing import ArrayLike, NDArray

from rig.control.excitation import ramp as fade
from rig.control.law import Law
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_CLAMPED, LAW_SIGNATURE

Floats = NDArray[np.float64]

STIFFNESS, DAMPING = range(2)  # parameters of both laws
# further places of the excited wall: length of the ramp, then one period of reactions
RAMP_TICKS, TABLE = 2, 3
PLAYED = 1  # state of the excited wall: tick of the excitation, plus one; 0 before the first
EXCITED_STATE = 2
TOUCHED = 1  # state of the clinging wall: 1 from the first contact on
CLINGING_STATE = 2


@kernel(types.float64(types.int64, types.int64), inline=True)
def ramp(tick: int, ticks: int) -> float:
    """Return the factor (0 to 1) by which an excitation is multiplied at `tick`: a raised cosine of length `ticks`."""
    if tick >= ticks:
        return 1.0
    return 0.5 - 0.5 * math.cos(math.pi * tick / ticks)


@kernel(LAW_SIGNATURE)
def bilateral(
    penetration: float, penetration_velocity: float, elapsed_ticks: int, state: Floats, parameters: Floats
) -> float:
    """Return the reaction K·penetration + B·velocity (N·m or N) on both sides of the surface; K and B may be 0."""
    state[LAW_CLAMPED] = 0.0
    return float(parameters[STIFFNESS] * penetration + parameters[DAMPING] * penetration_velocity)


@kernel(LAW_SIGNATURE)
def clinging(
    penetration: float, penetration_velocity: float, elapsed_ticks: int, state: Floats, parameters: Floats
) -> float:
    """Return the reaction (N·m or N) of a spring and damper that act on both sides from the first contact on."""
    state[LAW_CLAMPED] = 0.0
    if penetration > 0.0:
        state[TOUCHED] = 1.0
    if state[TOUCHED] == 0.0:
        return 0.0
    return float(parameters[STIFFNESS] * penetration + parameters[DAMPING] * penetration_velocity)


@kernel(LAW_SIGNATURE)
def excited(
    penetration: float, penetration_velocity: float, elapsed_ticks: int, state: Floats, parameters: Floats
) -> float:
    """Return the reaction of a spring and damper on both sides plus a periodic excitation (N·m or N).

    The excitation's period in `parameters` starts with the first tick of the trial, is faded in by `ramp`, and repeats.
    Lost samples count as ticks, so that the excitation stays in step with time.
    """
    state[LAW_CLAMPED] = 0.0
    played = int(state[PLAYED])
    tick = played - 1 + elapsed_ticks if played > 0 else 0
    state[PLAYED] = tick + 1
    reaction = parameters[STIFFNESS] * penetration + parameters[DAMPING] * penetration_velocity
    excitation = parameters[TABLE + tick % (parameters.shape[0] - TABLE)]
    return float(reaction + excitation * ramp(tick, int(parameters[RAMP_TICKS])))


def bilateral_law() -> Law:
    """Return the law of a spring and a damper on both sides of the wall's surface, for measurements of impedance."""
    return Law("bilateral", "spring and damper on both sides", bilateral, 1, design)


def clinging_law() -> Law:
    """Return the law of a spring and a damper that hold the handle on both sides from the first contact on."""
    return Law("clinging", "bilateral, once touched", clinging, CLINGING_STATE, design)


def excited_law(
    efforts: ArrayLike = (0.0,), ramp_ticks: int = 0, device: Mapping[str, int] | None = None
) -> Law:
    """Return the law of a spring and a damper on both sides with an excitation by the rig's own motor.

    `efforts` is one period at the loop's rate (N·m or N, positive with position), faded in over `ramp_ticks` ticks.
    `device` has the device parameters with which a device computes the same period (`rig.control.excitation_table`).
    """
    table = np.atleast_1d(np.asarray(efforts, dtype=np.float64))

    def designed(wall: Mapping[str, Any]) -> list[float]:
        return design_excited(wall, table, ramp_ticks)

    summary = "bilateral, and excited by the rig's own motor"
    return Law("excited", summary, excited, EXCITED_STATE, designed, dict(device or {}))


def design(wall: Mapping[str, Any]) -> list[float]:
    """Return stiffness and damping, the parameters of a spring and damper on both sides, from ``[wall]``."""
    return [wall["stiffness"], wall["damping"]]


def design_excited(wall: Mapping[str, Any], efforts: Floats, ramp_ticks: int) -> list[float]:
    """Return the law's parameters: stiffness, damping, fade-in (ticks), then the excitation as reactions (N·m or N).

    A reaction counts out of the wall: on side +1 it is minus the effort, which is positive with position.
    """
    reactions = (-wall["side"] * efforts).tolist()  # a reaction counts out of the wall
    return [*design(wall), float(ramp_ticks), *reactions]


def played(parameters: Floats, side: int, tick_s: float, ticks: int) -> Floats:
    """Return the excitation (N·m or N, positive with position) that a law's parameters give for the first ticks."""
    tick, table = np.arange(ticks), parameters[TABLE:]
    rising = fade(tick * tick_s, parameters[RAMP_TICKS] * tick_s)
    return np.asarray(-side * table[tick % len(table)] * rising)
