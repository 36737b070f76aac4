"""The simulated mechanics of a rig: exact between inner steps, Coulomb friction implicit, one kernel a tick.

`DiscretePlant.build` integrates the continuous matrices of `rig.model` once, with a matrix exponential, over
an inner step that divides the tick. `advance` then moves a plant by one tick: delay line, saturation, inner
steps, last encoder edge. The simulated device calls it from Python and the sweep from compiled code, with the
same arrays and so to the same bits.

**State.** Everything that changes lives in one flat array, so that copying it copies the plant: the states of
`rig.model.state_space`, then the age of the last encoder edge (s), then the commands still on their way,
oldest first.

**Friction.** In each inner step a friction effort is held, like the inputs, at the value that brings its mass
to rest by the end of the step, clipped to the Coulomb level. Two masses are coupled through the capstan;
their pair of friction efforts is found exactly. Static and kinetic friction are equal. A mass that is at rest
and stays so keeps its position to the last bit: stuck means stuck, where a regularised law would creep. The
price is a small error in a step in which a mass comes to rest or turns round: at most deceleration · step² / 8
in the length of a stop.

**What it mirrors.** The amplifier's limit and lag stand for stall torque and L/R of the motor's data sheet,
the delay for the ticks that a control computer spends between encoder and amplifier.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import types
from numpy.typing import NDArray
from scipy.linalg import expm

from firmware_protocol.kernel import kernel
from rig.errors import ConfigError
from rig.model import Matrix, RigModel, StateSpace, state_space
from sim_backend.sensors import cell, encoder_count

Vector = NDArray[np.float64]

RIGID_ORDER = 3  # states of a rigid rig; a two-mass rig has five

# Indices of `DiscretePlant.parameters`.
STEP_S = 0  # inner step (s)
STEPS = 1  # inner steps in a tick
EFFORT_LIMIT = 2  # the amplifier's saturation (N·m or N)
GRAVITY_EFFORT = 3  # weight of the end mass along the motion (N·m or N)
COULOMB = 4  # Coulomb level of the motor side, or of the whole rigid rig (N·m or N)
COULOMB_LINK = 5  # Coulomb level of the link side (N·m or N)
RESOLUTION = 6  # travel for one count (rad or m)
OFFSET = 7  # where position zero lies in its encoder cell (count)
SIGN = 8  # direction of counting, ±1
PARAMETERS = 9

_VECTOR = types.float64[::1]
_MATRIX = types.float64[:, ::1]
_FLOAT = types.float64
_INT = types.int64
_ADVANCE = _INT(_VECTOR, _MATRIX, _MATRIX, _VECTOR, _FLOAT, _FLOAT)


@dataclass(frozen=True, slots=True, eq=False)
class DiscretePlant:
    """A rig ready to be stepped: x ← phi x + gamma u in each inner step, and what the kernel needs beside it.

    Attributes
    ----------
    phi, gamma
        Discrete matrices over one inner step, states and inputs in the order of `rig.model`.
    parameters
        See the index constants of this module.
    tick_s
        Length of the tick (s).
    delay_ticks
        Whole ticks between a command and its effort.
    sensed_position, handle_position, effort, edge_age
        Indices into the state; each velocity follows its position.
    """

    phi: Matrix
    gamma: Matrix
    parameters: Vector
    tick_s: float
    delay_ticks: int
    sensed_position: int
    handle_position: int
    effort: int
    edge_age: int

    @classmethod
    def build(cls, model: RigModel, tick_s: float) -> DiscretePlant:
        """Discretise a rig for ticks of `tick_s` seconds.

        Raises
        ------
        ConfigError
            The tick is not above zero, or the inner step is too long for the mode of the capstan.
        """
        if not (tick_s > 0.0 and math.isfinite(tick_s)):
            raise ConfigError(f"a tick of {tick_s} s", remedy="choose a rate above zero")
        continuous = state_space(model.mechanics, model.amplifier)
        steps = max(1, math.ceil(tick_s / model.simulation.inner_step_s - 1e-9))  # 1e-9: 1 ms / 50 µs is 20
        phi, gamma = _exact(continuous, tick_s / steps)
        _check_friction(continuous, gamma, tick_s / steps)
        return cls(
            phi=phi,
            gamma=gamma,
            parameters=_parameters(model, continuous, tick_s / steps, steps),
            tick_s=tick_s,
            delay_ticks=model.simulation.computation_delay_ticks,
            sensed_position=continuous.sensed_position,
            handle_position=continuous.handle_position,
            effort=continuous.effort,
            edge_age=continuous.order,
        )

    @property
    def arrays(self) -> tuple[Matrix, Matrix, Vector]:
        """The plant's part of the arguments of `advance`."""
        return self.phi, self.gamma, self.parameters

    @property
    def commands(self) -> slice:
        """Where the state keeps the commands on their way, oldest first; zero them to cut the effort."""
        return slice(self.edge_age + 1, None)

    def at_rest(self, position: float) -> Vector:
        """State at rest at `position` (rad or m): no effort, no command on its way, no edge yet (age ∞)."""
        state = np.zeros(self.edge_age + 1 + self.delay_ticks)
        state[self.sensed_position] = state[self.handle_position] = position
        state[self.edge_age] = math.inf
        return state

    def count(self, state: Vector) -> int:
        """Encoder count in a state."""
        p = self.parameters
        position = state[self.sensed_position]
        return encoder_count(position, p[RESOLUTION], p[OFFSET], int(p[SIGN]))


def energy(state: Vector, model: RigModel) -> float:
    """Kinetic and elastic energy (J) in a state; gravity and electrical energy are left out."""
    mechanics = model.mechanics
    link = mechanics.loaded_link_inertia
    if mechanics.structure == "rigid":
        return float(0.5 * (mechanics.motor_inertia + link) * state[1] ** 2)
    kinetic = mechanics.motor_inertia * state[1] ** 2 + link * state[3] ** 2
    return float(0.5 * (kinetic + mechanics.transmission_stiffness * (state[2] - state[0]) ** 2))


def _exact(continuous: StateSpace, step_s: float) -> tuple[Matrix, Matrix]:
    """Zero-order-hold discretisation: exp([A B; 0 0] h) = [phi gamma; 0 1]."""
    order, inputs = continuous.b.shape
    both = np.zeros((order + inputs, order + inputs))
    both[:order] = np.hstack([continuous.a, continuous.b])
    whole = expm(both * step_s)
    phi, gamma = np.ascontiguousarray(whole[:order, :order]), np.ascontiguousarray(whole[:order, order:])
    without_lag = not continuous.a[continuous.effort].any()
    if without_lag:  # the effort state shows the command in force
        phi[continuous.effort, continuous.effort] = 0.0
        gamma[continuous.effort, 0] = 1.0
    return phi, gamma


def _check_friction(continuous: StateSpace, gamma: Matrix, step_s: float) -> None:
    """Refuse a step over which a friction effort can return as a velocity of the wrong sign.

    The gains from friction to velocity must be positive definite, for `_rub_both` to have one solution. They
    are while the step is shorter than about half a period of the capstan's mode.
    """
    gains = gamma[list(continuous.friction_velocity), 2:]
    if np.linalg.eigvalsh((gains + gains.T) / 2.0).min() <= 0.0:
        half_period_s = math.pi / float(np.abs(np.linalg.eigvals(continuous.a).imag).max())
        raise ConfigError(
            f"an inner step of {step_s:.3g} s is too long for the mode of the capstan",
            remedy=f"set simulation.inner_step_s well below {half_period_s:.3g} s, half its period",
        )


def _parameters(model: RigModel, continuous: StateSpace, step_s: float, steps: int) -> Vector:
    parameters = np.zeros(PARAMETERS)
    parameters[STEP_S] = step_s
    parameters[STEPS] = steps
    parameters[EFFORT_LIMIT] = model.amplifier.effort_limit
    parameters[GRAVITY_EFFORT] = model.mechanics.gravity_effort
    parameters[COULOMB : COULOMB + len(continuous.friction)] = continuous.friction
    parameters[RESOLUTION] = model.encoder.resolution
    parameters[OFFSET] = model.encoder.offset
    parameters[SIGN] = model.encoder.sign
    return parameters


@kernel(_FLOAT(_FLOAT, _FLOAT), inline=True)
def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


@kernel(types.UniTuple(_FLOAT, 2)(_FLOAT, _FLOAT, _FLOAT), inline=True)
def _rub(free: float, gain: float, coulomb: float) -> tuple[float, float]:
    """Friction effort on one mass, and the velocity it leaves: exactly zero when the mass comes to rest.

    `free` is the velocity at the end of the step without this friction, `gain` what a unit of it adds.
    """
    friction = free * (-1.0 / gain)  # the quotient leaves the loop, a division by gain would not
    if abs(friction) <= coulomb:
        return friction, 0.0
    friction = _clip(friction, coulomb)
    return friction, free + gain * friction


@kernel(types.UniTuple(_FLOAT, 4)(_FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT, _FLOAT), inline=True)
def _rub_both(
    free_motor: float,
    free_link: float,
    gain_motor: float,
    gain_cross: float,
    gain_link: float,
    coulomb_motor: float,
    coulomb_link: float,
) -> tuple[float, float, float, float]:
    """Friction efforts on motor and link, and the velocities they leave; see `_rub`.

    The pair solves a box-constrained linear complementarity problem whose matrix of gains is symmetric and
    positive definite, so there is exactly one. If the pair that stops both masses is admissible, it is that.
    Else one of the efforts that exceed their level lies at its level, and the other follows as for one mass.
    """
    shrink = -1.0 / (gain_motor * gain_link - gain_cross * gain_cross)
    motor = shrink * (gain_link * free_motor - gain_cross * free_link)
    link = shrink * (gain_motor * free_link - gain_cross * free_motor)
    if abs(motor) <= coulomb_motor and abs(link) <= coulomb_link:
        return motor, link, 0.0, 0.0
    if abs(motor) > coulomb_motor:
        rub = _clip(motor, coulomb_motor)
        rub_link, link_velocity = _rub(free_link + gain_cross * rub, gain_link, coulomb_link)
        motor_velocity = free_motor + gain_motor * rub + gain_cross * rub_link
        if rub * motor_velocity <= 0.0:  # it opposes the motion that it leaves
            return rub, rub_link, motor_velocity, link_velocity
    rub = _clip(link, coulomb_link)
    rub_motor, motor_velocity = _rub(free_motor + gain_cross * rub, gain_motor, coulomb_motor)
    return rub_motor, rub, motor_velocity, free_link + gain_cross * rub_motor + gain_link * rub


@kernel(_FLOAT(_FLOAT, _FLOAT, _FLOAT, _INT, _INT, _FLOAT, _FLOAT, _FLOAT), inline=True)
def _edge_age(
    age: float,
    before: float,
    after: float,
    old: int,
    new: int,
    step_s: float,
    resolution: float,
    offset: float,
) -> float:
    """Age of the last encoder edge after a step from position `before` to `after`, from cell `old` to `new`.

    The time of the edge is interpolated at the mean velocity of the step; of several edges the last counts.
    A step that leaves a cell and comes back to it within itself shows no edge.
    """
    if new == old:
        return age + step_s
    edge = new if new > old else new + 1
    left = (after - (edge - offset) * resolution) / (after - before)
    return min(max(left, 0.0), 1.0) * step_s


@kernel(_ADVANCE, inline=True)
def _advance_rigid(
    state: Vector, phi: Matrix, gamma: Matrix, parameters: Vector, command: float, external: float
) -> int:
    x, v, effort, age = state[0], state[1], state[2], state[3]
    step_s, coulomb = parameters[STEP_S], parameters[COULOMB]
    resolution, offset = parameters[RESOLUTION], parameters[OFFSET]
    push_x = gamma[0, 0] * command + gamma[0, 1] * external
    push_v = gamma[1, 0] * command + gamma[1, 1] * external
    count = cell(x, resolution, offset)
    for _ in range(int(parameters[STEPS])):
        free = phi[1, 1] * v + phi[1, 2] * effort + push_v
        friction, v_next = _rub(free, gamma[1, 2], coulomb)
        x_next = x
        if v != 0.0 or v_next != 0.0:
            x_next += phi[0, 1] * v + phi[0, 2] * effort + push_x + gamma[0, 2] * friction
        count_next = cell(x_next, resolution, offset)
        age = _edge_age(age, x, x_next, count, count_next, step_s, resolution, offset)
        effort = phi[2, 2] * effort + gamma[2, 0] * command
        x, v, count = x_next, v_next, count_next
    state[0], state[1], state[2], state[3] = x, v, effort, age
    return count


@kernel(_ADVANCE, inline=True)
def _advance_two_mass(
    state: Vector, phi: Matrix, gamma: Matrix, parameters: Vector, command: float, external: float
) -> int:
    """Positions act through the stretch alone: moving both masses alike changes nothing else."""
    x, v, y, w = state[0], state[1], state[2], state[3]  # motor and link: position, velocity
    effort, age = state[4], state[5]
    step_s, coulomb_v, coulomb_w = parameters[STEP_S], parameters[COULOMB], parameters[COULOMB_LINK]
    resolution, offset = parameters[RESOLUTION], parameters[OFFSET]
    push_x = gamma[0, 0] * command + gamma[0, 1] * external
    push_v = gamma[1, 0] * command + gamma[1, 1] * external
    push_y = gamma[2, 0] * command + gamma[2, 1] * external
    push_w = gamma[3, 0] * command + gamma[3, 1] * external
    count = cell(x, resolution, offset)
    for _ in range(int(parameters[STEPS])):
        stretch = y - x
        free_v = phi[1, 1] * v + phi[1, 2] * stretch + phi[1, 3] * w + phi[1, 4] * effort + push_v
        free_w = phi[3, 1] * v + phi[3, 2] * stretch + phi[3, 3] * w + phi[3, 4] * effort + push_w
        rub_v, rub_w, v_next, w_next = _rub_both(
            free_v, free_w, gamma[1, 2], gamma[3, 2], gamma[3, 3], coulomb_v, coulomb_w
        )
        x_next, y_next = x, y
        if v != 0.0 or v_next != 0.0:
            x_next += phi[0, 1] * v + phi[0, 2] * stretch + phi[0, 3] * w + phi[0, 4] * effort + push_x
            x_next += gamma[0, 2] * rub_v + gamma[0, 3] * rub_w
        if w != 0.0 or w_next != 0.0:
            y_next += phi[2, 1] * v - phi[2, 0] * stretch + phi[2, 3] * w + phi[2, 4] * effort + push_y
            y_next += gamma[2, 2] * rub_v + gamma[2, 3] * rub_w
        count_next = cell(x_next, resolution, offset)
        age = _edge_age(age, x, x_next, count, count_next, step_s, resolution, offset)
        effort = phi[4, 4] * effort + gamma[4, 0] * command
        x, v, y, w, count = x_next, v_next, y_next, w_next, count_next
    state[0], state[1], state[2], state[3] = x, v, y, w
    state[4], state[5] = effort, age
    return count


@kernel(_ADVANCE, inline=True)
def advance(
    state: Vector,
    phi: Matrix,
    gamma: Matrix,
    parameters: Vector,
    command_effort: float,
    external_effort: float,
) -> int:
    """Move a plant by one tick.

    Parameters
    ----------
    state
        From `DiscretePlant.at_rest`; changed in place.
    phi, gamma, parameters
        `DiscretePlant.arrays`.
    command_effort
        Effort asked of the amplifier from this tick on (N·m or N, finite). It acts `delay_ticks` ticks later,
        clipped to the effort limit, through the electrical lag.
    external_effort
        Effort of the world on the link during the tick (N·m or N, finite).

    Returns
    -------
    int
        Encoder count at the end of the tick.

    Notes
    -----
    Inlined into compiled callers: counting references to its arrays would cost more than a step.
    """
    order = phi.shape[0]
    in_force = command_effort
    last = state.shape[0] - 1
    if last > order:
        in_force = state[order + 1]
        for i in range(order + 1, last):
            state[i] = state[i + 1]
        state[last] = command_effort
    in_force = _clip(in_force, parameters[EFFORT_LIMIT])
    external = external_effort + parameters[GRAVITY_EFFORT]
    if order == RIGID_ORDER:
        count = _advance_rigid(state, phi, gamma, parameters, in_force, external)
    else:
        count = _advance_two_mass(state, phi, gamma, parameters, in_force, external)
    return int(parameters[SIGN]) * count
