"""Laws for what is linear: a spring and a damper on both sides of a point, also excited, also once touched.

A wall with a free side is not linear, so a measurement is made about a point inside a wall that also pulls. The rig's
own motor may play an excitation on top: one period of efforts in the law's parameters, played by elapsed ticks and
not by a clock, so that the same law runs without bytes, over the byte link, in real time and in a replay.

Excited runs and identification of `rig.experiments`, the reproductions of papers and the simulation call it. Kernels
here must not allocate, and must not know what moves the bytes.
"""

from __future__ import annotations

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
    """Return the share of an excitation that is played at a tick: from 0 to 1, with a continuous slope."""
    if tick >= ticks:
        return 1.0
    return 0.5 - 0.5 * math.cos(math.pi * tick / ticks)


@kernel(LAW_SIGNATURE)
def bilateral(
    penetration: float, penetration_velocity: float, elapsed_ticks: int, state: Floats, parameters: Floats
) -> float:
    """Return the reaction K·penetration + B·velocity, wherever the handle is (N·m or N); both may be zero."""
    state[LAW_CLAMPED] = 0.0
    return float(parameters[STIFFNESS] * penetration + parameters[DAMPING] * penetration_velocity)


@kernel(LAW_SIGNATURE)
def clinging(
    penetration: float, penetration_velocity: float, elapsed_ticks: int, state: Floats, parameters: Floats
) -> float:
    """Return 0 until the wall is touched, then the reaction of the bilateral wall, in free space too (N·m or N)."""
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
    """Return the reaction of the bilateral wall plus that of the table, for the ticks since the law began (N·m or N).

    The table begins with the first tick of the trial, rises with `ramp` and goes round. Ticks that a link lost are
    skipped in it, as they are in time.
    """
    state[LAW_CLAMPED] = 0.0
    played = int(state[PLAYED])
    tick = played - 1 + elapsed_ticks if played > 0 else 0
    state[PLAYED] = tick + 1
    reaction = parameters[STIFFNESS] * penetration + parameters[DAMPING] * penetration_velocity
    excitation = parameters[TABLE + tick % (parameters.shape[0] - TABLE)]
    return float(reaction + excitation * ramp(tick, int(parameters[RAMP_TICKS])))


def bilateral_law() -> Law:
    """Return the law of the wall on both sides."""
    return Law("bilateral", "spring and damper on both sides", bilateral, 1, design)


def clinging_law() -> Law:
    """Return the wall that does not let go of a handle that has touched it."""
    return Law("clinging", "bilateral, once touched", clinging, CLINGING_STATE, design)


def excited_law(
    efforts: ArrayLike = (0.0,), ramp_ticks: int = 0, device: Mapping[str, int] | None = None
) -> Law:
    """Return the bilateral wall with an excitation that the rig's own motor plays.

    Parameters
    ----------
    efforts
        One period at the loop's rate, positive along the position (N·m or N), at least one sample.
    ramp_ticks
        Ticks in which the excitation rises.
    device
        Parameters from which a device makes the same table (`rig.control.excitation_table`).
    """
    table = np.atleast_1d(np.asarray(efforts, dtype=np.float64))

    def designed(wall: Mapping[str, Any]) -> list[float]:
        return design_excited(wall, table, ramp_ticks)

    summary = "bilateral, and excited by the rig's own motor"
    return Law("excited", summary, excited, EXCITED_STATE, designed, dict(device or {}))


def design(wall: Mapping[str, Any]) -> list[float]:
    """Return the parameters of the bilateral wall from the settings of ``[wall]``."""
    return [wall["stiffness"], wall["damping"]]


def design_excited(wall: Mapping[str, Any], efforts: Floats, ramp_ticks: int) -> list[float]:
    """Return the parameters of the excited wall; see `excited_law`."""
    reactions = (-wall["side"] * efforts).tolist()  # a reaction counts out of the wall
    return [*design(wall), float(ramp_ticks), *reactions]


def played(parameters: Floats, side: int, tick_s: float, ticks: int) -> Floats:
    """Return the excitation (N·m or N, along the position) that these parameters play in their first ticks."""
    tick, table = np.arange(ticks), parameters[TABLE:]
    rising = fade(tick * tick_s, parameters[RAMP_TICKS] * tick_s)
    return np.asarray(-side * table[tick % len(table)] * rising)
