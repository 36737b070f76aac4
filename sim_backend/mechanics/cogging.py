"""Simulate a rig whose motor cogs: the plant of `sim_backend.mechanics.plant`, plus an effort that depends on position.

The file simulates the slots of an iron-cored motor and a torque constant that varies with the position
(`rig.core.model.Cogging`). Back-EMF under voltage drive has no ripple here. `plant` uses it.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numba import types

from rig.control.cogging import effort_at
from rig.core.model import Matrix, StateSpace
from rig.realtime.kernel import kernel
from sim_backend.mechanics.inner import (
    ADVANCE,
    COULOMB,
    COULOMB_LINK,
    MEAN,
    OFFSET,
    PARAMETERS,
    RESOLUTION,
    RIPPLE,
    STEP_S,
    STEPS,
    Vector,
    encode,
    rub_both,
)
from sim_backend.mechanics.sensors import cell

# States of two masses in a hand; then the intention of the hand, and the age of the last edge.
MOTOR, LINK, EFFORT, HAND, WANTED, EDGE_AGE = 0, 2, 4, 5, 7, 10
COMMAND, EXTERNAL, RUBS_MOTOR, RUBS_LINK, INPUTS = 0, 1, 2, 3, 7

_FLOAT, _MATRIX = types.float64, types.float64[:, ::1]


# One kernel serves all structures, with and without a hand: a plant is expanded to the states of the largest, and
# those of missing masses stay zero.
def expand_states(rig: StateSpace) -> StateSpace:
    """Return a rig's matrices with the states of two masses in a hand; states that the rig does not have stay zero."""
    held, rigid = rig.hand_position is not None, len(rig.friction) == 1
    states = [MOTOR, MOTOR + 1, *(() if rigid else (LINK, LINK + 1)), EFFORT]
    inputs = [COMMAND, EXTERNAL, RUBS_MOTOR, *(() if rigid else (RUBS_LINK,))]
    if held:
        states += [HAND, HAND + 1]
        inputs += [*range(RUBS_LINK + 1, INPUTS)]
    a, b = np.zeros((WANTED, WANTED)), np.zeros((WANTED, INPUTS))
    a[np.ix_(states, states)], b[np.ix_(states, inputs)] = rig.a, rig.b
    if rigid:
        b[LINK + 1, RUBS_LINK] = 1.0  # any value above 0: a rigid rig has no second mass
    return replace(
        rig,
        a=a,
        b=b,
        handle_position=MOTOR if rigid else LINK,
        effort=EFFORT,
        friction=(*rig.friction, 0.0)[:2],
        friction_velocity=(MOTOR + 1, LINK + 1),
        hand_position=HAND if held else None,
    )


def mean_weight(step_s: float, lag_s: float) -> float:
    """Return the weight (0 to 1) of a step's final effort in its mean effort, for a first-order lag; 1 without lag."""
    return 1.0 if lag_s == 0.0 else -1.0 / math.expm1(-step_s / lag_s) - lag_s / step_s


@kernel(_FLOAT(_MATRIX, types.int64, *(_FLOAT,) * 8), inline=True, no_refcount=True)
def _carry(
    phi: Matrix,
    row: int,
    x: float,
    v: float,
    y: float,
    w: float,
    effort: float,
    h: float,
    g: float,
    goal: float,
) -> float:
    """Return what the present states contribute to state number `row` after one integration step.

    `x`, `y`, `h`, `goal` (positions of motor, link, hand and its target) are relative to the mass of this row; `v`, `w`
    and `g` are the velocities of motor, link and hand.
    """
    hand = phi[row, 5] * h + phi[row, 6] * g + phi[row, 7] * goal
    return float(
        phi[row, 0] * x + phi[row, 1] * v + phi[row, 2] * y + phi[row, 3] * w + phi[row, 4] * effort + hand
    )


@kernel(_FLOAT(_MATRIX, _MATRIX, types.int64, *(_FLOAT,) * 4), inline=True, no_refcount=True)
def _push(
    phi: Matrix, gamma: Matrix, row: int, command: float, external: float, velocity: float, press: float
) -> float:
    """Return what the inputs contribute to state number `row` after one integration step; they are constant in a tick.

    Inputs are the commanded and external effort (N·m or N), and the hand's intended velocity and pressing effort.
    """
    hand = phi[row, 8] * velocity + phi[row, 9] * press
    return float(gamma[row, COMMAND] * command + gamma[row, EXTERNAL] * external + hand)


@kernel(_FLOAT(_MATRIX, types.int64, _FLOAT, _FLOAT), inline=True, no_refcount=True)
def _add_friction(gamma: Matrix, row: int, motor: float, link: float) -> float:
    """Return what efforts on motor and link (N·m or N) contribute to state number `row` after one integration step."""
    return float(gamma[row, RUBS_MOTOR] * motor + gamma[row, RUBS_LINK] * link)


@kernel(ADVANCE, no_refcount=True)
def advance(
    state: Vector, phi: Matrix, gamma: Matrix, parameters: Any, command: float, external: float
) -> int:
    """Move a plant with a cogging motor by one tick; return the encoder count, without the encoder's sign.

    `state` has the states of `expand_states`. `command` is the effort that acts in this tick, after delay and limit;
    `external` acts on the link (N·m or N).
    """
    x, v, y, w, effort = state[0], state[1], state[2], state[3], state[4]  # motor, link, motor effort
    h, g, goal, velocity, press, age = state[5], state[6], state[7], state[8], state[9], state[10]
    begins = int(parameters[RIPPLE])
    harmonics, ripple, last = parameters[PARAMETERS:begins], parameters[begins:], parameters[MEAN]
    step_s, resolution, offset = parameters[STEP_S], parameters[RESOLUTION], parameters[OFFSET]
    push_x = _push(phi, gamma, 0, command, external, velocity, press)
    push_v = _push(phi, gamma, 1, command, external, velocity, press)
    push_y = _push(phi, gamma, 2, command, external, velocity, press)
    push_w = _push(phi, gamma, 3, command, external, velocity, press)
    push_e = _push(phi, gamma, 4, command, external, velocity, press)
    push_h = _push(phi, gamma, 5, command, external, velocity, press)
    push_g = _push(phi, gamma, 6, command, external, velocity, press)
    count = cell(x, resolution, offset)
    for _ in range(int(parameters[STEPS])):
        stretch, reach, far = y - x, h - x, goal - x  # as seen from the motor, and the same from the link
        kept = _carry(phi, 4, 0.0, v, stretch, w, effort, reach, g, far)
        # Held over the step at its value half way: on a free motor that is drift, kick, drift (leapfrog), which is
        # symplectic, so cogging stores energy and makes none. A motor at rest stays there: stuck means stuck here too.
        # What ripple adds belongs to the effort's mean over the step, at the same place.
        mean, halfway = effort + last * (kept + push_e - effort), x + 0.5 * step_s * v
        cogs = effort_at(halfway, harmonics) + mean * effort_at(halfway, ripple)
        free_v = _carry(phi, 1, 0.0, v, stretch, w, effort, reach, g, far) + push_v + gamma[1, 2] * cogs
        free_w = _carry(phi, 3, -stretch, v, 0.0, w, effort, h - y, g, goal - y) + push_w
        rub_v, rub_w, v_next, w_next = rub_both(
            free_v,
            free_w + gamma[3, 2] * cogs,
            gamma[1, 2],
            gamma[3, 2],
            gamma[3, 3],
            parameters[COULOMB],
            parameters[COULOMB_LINK],
        )
        on_motor = rub_v + cogs
        x_next, y_next = x, y
        if v != 0.0 or v_next != 0.0:
            x_next += _carry(phi, 0, 0.0, v, stretch, w, effort, reach, g, far)
            x_next += push_x + _add_friction(gamma, 0, on_motor, rub_w)
        if w != 0.0 or w_next != 0.0:
            y_next += _carry(phi, 2, -stretch, v, 0.0, w, effort, h - y, g, goal - y)
            y_next += push_y + _add_friction(gamma, 2, on_motor, rub_w)
        h_next = h + _carry(phi, 5, -reach, v, y - h, w, effort, 0.0, g, goal - h)
        g_next = _carry(phi, 6, -reach, v, y - h, w, effort, 0.0, g, goal - h)
        effort = kept + (push_e + _add_friction(gamma, 4, on_motor, rub_w))
        h = h_next + push_h + _add_friction(gamma, 5, on_motor, rub_w)
        g = g_next + push_g + _add_friction(gamma, 6, on_motor, rub_w)
        count, age = encode(count, age, x, x_next, step_s, resolution, offset)
        x, v, y, w = x_next, v_next, y_next, w_next
    state[0], state[1], state[2], state[3], state[4] = x, v, y, w, effort
    state[5], state[6], state[10] = h, g, age
    return count
