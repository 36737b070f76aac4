"""Simulate a rig in a person's hand exactly: the plant of `sim_backend.mechanics.plant`, a hand mass and its intention.

States: those of the rig, hand position and velocity, then the person's intended position, intended velocity and
pressing effort. The last three keep their values until the hand's scripted motion (`sim_backend.mechanics.operator`)
writes others. `plant` uses it for a rig that a person holds.
"""

from typing import Any

from numba import types

from rig.core.model import Matrix
from rig.realtime.kernel import kernel
from sim_backend.mechanics.inner import (
    ADVANCE,
    COULOMB,
    COULOMB_LINK,
    OFFSET,
    RESOLUTION,
    STEP_S,
    STEPS,
    Vector,
    encode,
    rub_both,
    rub_one,
)
from sim_backend.mechanics.sensors import cell

INTENTIONS = 3  # intended position, intended velocity, press
HAND_ORDER = 2 + INTENTIONS  # states that a hand adds: its position, its velocity, and these

_FLOAT, _INT, _MATRIX = types.float64, types.int64, types.float64[:, ::1]


@kernel(_INT(types.float64[::1], _INT, _MATRIX, _INT, _INT), inline=True, no_refcount=True)
def want(state: Any, edge_age: int, script: Any, row: int, again: int) -> int:
    """Copy row `row` of a hand's scripted motion to its place in `state`; return the number of the next row.

    Its place ends before the index `edge_age`. Row `again` follows the last row. An empty script changes nothing.
    """
    if script.shape[0] == 0:
        return 0
    for i in range(INTENTIONS):
        state[edge_age - INTENTIONS + i] = script[row, i]
    return row + 1 if row + 1 < script.shape[0] else again


@kernel(_FLOAT(_MATRIX, _MATRIX, _INT, _FLOAT, _FLOAT, _FLOAT, _FLOAT), inline=True, no_refcount=True)
def _push(
    phi: Matrix,
    gamma: Matrix,
    row: int,
    command: float,
    external: float,
    wanted_velocity: float,
    press: float,
) -> float:
    """Return what the inputs contribute to state number `row` after one integration step; they are constant in a tick.

    Inputs are the commanded and external effort (N·m or N), and the hand's intended velocity and pressing effort.
    """
    order = phi.shape[0]
    hand = phi[row, order - 2] * wanted_velocity + phi[row, order - 1] * press
    return float(gamma[row, 0] * command + gamma[row, 1] * external + hand)


@kernel(_FLOAT(_MATRIX, _INT, _FLOAT, _FLOAT, _FLOAT, _FLOAT), inline=True, no_refcount=True)
def _carry(phi: Matrix, row: int, v: float, w: float, effort: float, g: float) -> float:
    """Return what velocities (motor v, link w, hand g) and motor effort contribute to state `row` after one step."""
    return float(phi[row, 1] * v + phi[row, 3] * w + phi[row, 4] * effort + phi[row, 6] * g)


@kernel(ADVANCE, no_refcount=True)
def advance_rigid(
    state: Vector, phi: Matrix, gamma: Matrix, parameters: Vector, command: float, external: float
) -> int:
    """Move a rigid rig in a hand by one tick; return the encoder count, without the encoder's sign.

    `command` is the effort that acts in this tick, after delay and limit; `external` acts on the link (N·m or N).
    """
    x, v, effort, h, g = state[0], state[1], state[2], state[3], state[4]  # link, motor effort, hand
    goal, goal_velocity, press, age = state[5], state[6], state[7], state[8]
    step_s, coulomb = parameters[STEP_S], parameters[COULOMB]
    resolution, offset = parameters[RESOLUTION], parameters[OFFSET]
    push_x = _push(phi, gamma, 0, command, external, goal_velocity, press)
    push_v = _push(phi, gamma, 1, command, external, goal_velocity, press)
    push_e = _push(phi, gamma, 2, command, external, goal_velocity, press)
    push_h = _push(phi, gamma, 3, command, external, goal_velocity, press)
    push_g = _push(phi, gamma, 4, command, external, goal_velocity, press)
    count = cell(x, resolution, offset)
    for _ in range(int(parameters[STEPS])):
        # Only distances enter the products: shifting all positions alike changes nothing else, to the last bit.
        grip, wish, want = h - x, goal - x, goal - h
        free = (
            phi[1, 1] * v + phi[1, 2] * effort + phi[1, 4] * g + phi[1, 3] * grip + phi[1, 5] * wish + push_v
        )
        friction, v_next = rub_one(free, gamma[1, 2], coulomb)
        x_next = x
        if v != 0.0 or v_next != 0.0:
            x_next += phi[0, 1] * v + phi[0, 2] * effort + phi[0, 4] * g + phi[0, 3] * grip + phi[0, 5] * wish
            x_next += push_x + gamma[0, 2] * friction
        h_next = phi[3, 1] * v + phi[3, 2] * effort + phi[3, 4] * g - phi[3, 0] * grip + phi[3, 5] * want
        g_next = phi[4, 1] * v + phi[4, 2] * effort + phi[4, 4] * g - phi[4, 0] * grip + phi[4, 5] * want
        effort = phi[2, 1] * v + phi[2, 2] * effort + phi[2, 4] * g + phi[2, 3] * grip + phi[2, 5] * wish
        effort += push_e + gamma[2, 2] * friction
        h += h_next + push_h + gamma[3, 2] * friction
        g = g_next + push_g + gamma[4, 2] * friction
        count, age = encode(count, age, x, x_next, step_s, resolution, offset)
        x, v = x_next, v_next
    state[0], state[1], state[2], state[3], state[4] = x, v, effort, h, g
    state[8] = age
    return count


@kernel(ADVANCE, no_refcount=True)
def advance_two_mass(
    state: Vector, phi: Matrix, gamma: Matrix, parameters: Vector, command: float, external: float
) -> int:
    """Move a rig with two masses in a hand by one tick; return the encoder count, without the encoder's sign.

    `command` is the effort that acts in this tick, after delay and limit; `external` acts on the link (N·m or N).
    """
    x, v, y, w, effort = state[0], state[1], state[2], state[3], state[4]  # motor, link, motor effort
    h, g, goal, goal_velocity, press, age = state[5], state[6], state[7], state[8], state[9], state[10]
    step_s, coulomb_v, coulomb_w = parameters[STEP_S], parameters[COULOMB], parameters[COULOMB_LINK]
    resolution, offset = parameters[RESOLUTION], parameters[OFFSET]
    push_x = _push(phi, gamma, 0, command, external, goal_velocity, press)
    push_v = _push(phi, gamma, 1, command, external, goal_velocity, press)
    push_y = _push(phi, gamma, 2, command, external, goal_velocity, press)
    push_w = _push(phi, gamma, 3, command, external, goal_velocity, press)
    push_e = _push(phi, gamma, 4, command, external, goal_velocity, press)
    push_h = _push(phi, gamma, 5, command, external, goal_velocity, press)
    push_g = _push(phi, gamma, 6, command, external, goal_velocity, press)
    count = cell(x, resolution, offset)
    for _ in range(int(parameters[STEPS])):
        stretch, reach, far = y - x, h - x, goal - x  # as seen from the motor
        grip, wish, want = h - y, goal - y, goal - h  # from the link; from the hand
        free_v = phi[1, 2] * stretch + phi[1, 5] * reach + phi[1, 7] * far
        free_v += _carry(phi, 1, v, w, effort, g) + push_v
        free_w = phi[3, 5] * grip + phi[3, 7] * wish - phi[3, 0] * stretch
        free_w += _carry(phi, 3, v, w, effort, g) + push_w
        rub_v, rub_w, v_next, w_next = rub_both(
            free_v, free_w, gamma[1, 2], gamma[3, 2], gamma[3, 3], coulomb_v, coulomb_w
        )
        x_next, y_next = x, y
        if v != 0.0 or v_next != 0.0:
            x_next += phi[0, 2] * stretch + phi[0, 5] * reach + phi[0, 7] * far
            x_next += _carry(phi, 0, v, w, effort, g) + push_x + gamma[0, 2] * rub_v + gamma[0, 3] * rub_w
        if w != 0.0 or w_next != 0.0:
            y_next += phi[2, 5] * grip + phi[2, 7] * wish - phi[2, 0] * stretch
            y_next += _carry(phi, 2, v, w, effort, g) + push_y + gamma[2, 2] * rub_v + gamma[2, 3] * rub_w
        h_next = phi[5, 7] * want - phi[5, 2] * grip - phi[5, 0] * reach
        g_next = phi[6, 7] * want - phi[6, 2] * grip - phi[6, 0] * reach
        h_next += _carry(phi, 5, v, w, effort, g) + push_h + gamma[5, 2] * rub_v + gamma[5, 3] * rub_w
        e_next = phi[4, 2] * stretch + phi[4, 5] * reach + phi[4, 7] * far
        e_next += _carry(phi, 4, v, w, effort, g) + push_e + gamma[4, 2] * rub_v + gamma[4, 3] * rub_w
        g = g_next + _carry(phi, 6, v, w, effort, g) + push_g + gamma[6, 2] * rub_v + gamma[6, 3] * rub_w
        h += h_next
        effort = e_next
        count, age = encode(count, age, x, x_next, step_s, resolution, offset)
        x, v, y, w = x_next, v_next, y_next, w_next
    state[0], state[1], state[2], state[3], state[4] = x, v, y, w, effort
    state[5], state[6], state[10] = h, g, age
    return count
