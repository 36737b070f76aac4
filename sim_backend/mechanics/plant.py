"""Simulate the mechanics of a rig: exact over an integration step, implicit Coulomb friction, one kernel call a tick.

Devices call `advance` from Python and sweeps call it from compiled code; with the same arrays both give the same bits.
Everything that changes is in one flat array, so a copy of that array is a copy of the plant. The array contains the
states of `rig.core.model.state_space`, the intended motion of a person who holds the handle (if there is one), the age
of the last encoder edge (s), and the commands that do not act yet because of the delay, oldest first.

The amplifier's limit and lag represent stall torque and L/R of the motor's data sheet. Under voltage drive the command
is the voltage in units of effort; the effort state is k_t times the current, back-EMF included.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np
from numba import types

from rig.core.errors import ConfigError
from rig.core.exponential import expm
from rig.core.model import Matrix, RigModel, StateSpace, state_space
from rig.realtime.groups import FloatRows, Floats, Int, group, type_of
from rig.realtime.kernel import kernel
from rig.realtime.plugs import NativeFunction
from sim_backend.mechanics import cogging, coupled_hand
from sim_backend.mechanics.coupled_hand import HAND_ORDER, INTENTIONS
from sim_backend.mechanics.inner import (
    ADVANCE,
    COULOMB,
    COULOMB_LINK,
    EFFORT_LIMIT,
    GRAVITY_EFFORT,
    MEAN,
    OFFSET,
    PARAMETERS,
    RESOLUTION,
    RIPPLE,
    SIGN,
    STEP_S,
    STEPS,
    Vector,
    clip,
    encode,
    rub_both,
    rub_one,
)
from sim_backend.mechanics.sensors import cell, encoder_count

RIGID_ORDER, TWO_MASS_ORDER = 3, 5  # states of a rig without a hand


@group
class PlantArguments(NamedTuple):
    """Arguments of `advance`: the changing state of a plant, and the matrices and indices of its `DiscretePlant`.

    `other` is the function that moves a plant by one tick if a hand holds it or its motor cogs. It is passed by
    address, so that a program which simulates neither does not compile it.
    """

    state: Floats
    phi: FloatRows
    gamma: FloatRows
    parameters: Floats
    other: Annotated[Any, types.FunctionType(ADVANCE)]
    sensed_position: Int
    handle_position: Int
    effort: Int
    edge_age: Int


PLANT_TYPE = type_of(PlantArguments)


@dataclass(frozen=True, slots=True, eq=False)
class DiscretePlant:
    """A discretised rig: x ← phi x + gamma u in each integration step, with the parameters that `advance` needs.

    Attributes
    ----------
    phi, gamma
        Discrete matrices over one integration step, states and inputs in the order of `rig.core.model`.
    parameters
        Friction, encoder and limits, at the indices that `sim_backend.mechanics.inner` names.
    tick_s
        Length of the tick (s).
    delay_ticks
        Ticks between a command and the effort that follows from it.
    sensed_position, handle_position, effort, edge_age
        Indices into the state; each velocity follows its position.
    hand_position
        Index of the hand's position in the state; None without a hand.
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
    hand_position: int | None = None

    @classmethod
    def build(cls, model: RigModel, tick_s: float) -> DiscretePlant:
        """Return a rig discretised for ticks of `tick_s` seconds. Results are cached: do not write to the arrays.

        Raise `ConfigError` if the tick is not above zero, or the integration step is too long for the vibration mode of
        the capstan.
        """
        if not (tick_s > 0.0 and math.isfinite(tick_s)):
            raise ConfigError(
                f"the length of a tick, {tick_s} s, must be finite and above 0",
                remedy="choose a tick rate above 0 Hz",
            )
        return _discretise(model, tick_s)

    @property
    def arrays(self) -> tuple[Matrix, Matrix, Vector]:
        """Return the arrays `phi`, `gamma` and `parameters` of this plant."""
        return self.phi, self.gamma, self.parameters

    def arguments(self, state: Vector) -> PlantArguments:
        """Return the arguments with which `advance` moves this plant; `advance` changes `state` in place."""
        return PlantArguments(
            state=state,
            phi=self.phi,
            gamma=self.gamma,
            parameters=self.parameters,
            other=cogging.advance if self.cogs else _OTHER[len(self.phi)],
            sensed_position=self.sensed_position,
            handle_position=self.handle_position,
            effort=self.effort,
            edge_age=self.edge_age,
        )

    @property
    def intentions(self) -> slice:
        """Return the slice of the state with the hand's intended position, velocity and pressing effort, if any."""
        return slice(self.edge_age - (0 if self.hand_position is None else INTENTIONS), self.edge_age)

    @property
    def commands(self) -> slice:
        """Return the slice of the state with the commands that do not act yet, oldest first; zeros cancel them."""
        return slice(self.edge_age + 1, None)

    def at_rest(self, position: float) -> Vector:
        """Return the plant's state at rest at `position` (rad or m): no effort, no delayed command, no encoder edge.

        A hand is at the same position and intends to stay there. The age of the last edge is ∞.
        """
        state = np.zeros(self.edge_age + 1 + self.delay_ticks)
        state[self.sensed_position] = state[self.handle_position] = position
        if self.hand_position is not None:
            state[self.hand_position] = state[self.intentions.start] = position
        state[self.edge_age] = math.inf
        return state

    @property
    def cogs(self) -> bool:
        """Return True if the motor cogs; the state then has the layout of `sim_backend.mechanics.cogging`."""
        return len(self.parameters) > PARAMETERS

    def count(self, state: Vector) -> int:
        """Return the encoder count for a state of this plant."""
        p = self.parameters
        position = state[self.sensed_position]
        return encoder_count(position, p[RESOLUTION], p[OFFSET], int(p[SIGN]))


@lru_cache(maxsize=64)
def _discretise(model: RigModel, tick_s: float) -> DiscretePlant:
    continuous = state_space(model.mechanics, model.amplifier, model.operator)
    if model.cogging.orders:
        continuous = cogging.expand_states(continuous)
    # Minus 1e-9: 1 ms / 50 µs must give 20 steps, not 21, whatever the quotient's last bit.
    steps = max(1, math.ceil(tick_s / model.simulation.inner_step_s - 1e-9))
    phi, gamma = _exact(continuous, tick_s / steps)
    _check_friction(continuous, gamma, tick_s / steps)
    return DiscretePlant(
        phi=phi,
        gamma=gamma,
        parameters=_parameters(model, continuous, tick_s / steps, steps),
        tick_s=tick_s,
        delay_ticks=model.delay_ticks(tick_s),
        sensed_position=continuous.sensed_position,
        handle_position=continuous.handle_position,
        effort=continuous.effort,
        edge_age=len(phi),
        hand_position=continuous.hand_position,
    )


def energy(state: Vector, model: RigModel) -> float:
    """Return the kinetic and elastic energy (J) of a plant's state, with hand and cogging, without gravity."""
    mechanics, operator = model.mechanics, model.operator
    rigid = mechanics.structure == "rigid"
    link = mechanics.loaded_link_inertia
    radius = mechanics.handle_radius
    handle = 0 if rigid else 2
    twice = 0.0
    if operator is not None:
        # Index of the hand: behind three states of a rigid rig, five of a compliant one. With cogging every rig has the
        # five (`cogging.expand_states`).
        h = 3 if rigid and not model.cogging.orders else 5
        link += operator.pads_mass * radius**2
        pads, hand = state[h] - state[handle], state[h + 2] - state[h]
        elastic = operator.pads_stiffness * pads**2 + operator.hand_stiffness * hand**2
        twice = radius**2 * (operator.hand_mass * state[h + 1] ** 2 + elastic)
    if rigid:
        twice += (mechanics.motor_inertia + link) * state[1] ** 2
    else:
        twice += mechanics.motor_inertia * state[1] ** 2 + link * state[3] ** 2
        twice += mechanics.transmission_stiffness * (state[2] - state[0]) ** 2
    return float(0.5 * twice + model.cogging.energy(state[0]))


def _exact(continuous: StateSpace, step_s: float) -> tuple[Matrix, Matrix]:
    """Return phi and gamma of the zero-order-hold discretisation: exp([A B; 0 0] step_s) = [phi gamma; 0 1]."""
    order, inputs = continuous.b.shape
    # Van Loan: one exponential gives phi and gamma, also where A is singular (a free mass has no spring).
    block_matrix = np.zeros((order + inputs, order + inputs))
    block_matrix[:order] = np.hstack([continuous.a, continuous.b])
    exponential = expm(block_matrix * step_s)
    # A hand's intention is an input that stays until it is changed: a state.
    first_intention = order + continuous.operator_inputs.start
    states = [*range(order), *range(first_intention, order + inputs)]
    phi = np.ascontiguousarray(exponential[np.ix_(states, states)])
    gamma = np.ascontiguousarray(exponential[np.ix_(states, range(order, first_intention))])
    without_lag = not continuous.a[continuous.effort].any()
    if without_lag:  # the effort state shows the active command, less the back-EMF of the velocity reached
        effort, motor_velocity = continuous.effort, continuous.sensed_position + 1
        phi[effort] = -continuous.back_emf * phi[motor_velocity]
        gamma[effort] = -continuous.back_emf * gamma[motor_velocity]
        gamma[effort, 0] += 1.0
    return phi, gamma


def _check_friction(continuous: StateSpace, gamma: Matrix, step_s: float) -> None:
    """Raise `ConfigError` if the step is so long that friction could change a velocity in the wrong direction."""
    # `rub_both` has one solution only if the gains from friction to velocity are positive definite. They are while the
    # step is shorter than about half a period of the capstan's mode.
    gains = gamma[list(continuous.friction_velocity), continuous.friction_inputs]
    if np.linalg.eigvalsh((gains + gains.T) / 2.0).min() <= 0.0:
        half_period_s = math.pi / float(np.abs(np.linalg.eigvals(continuous.a).imag).max())
        raise ConfigError(
            f"simulation.inner_step_s = {step_s:.3g} s is too long for the vibration mode of the capstan",
            remedy=f"set simulation.inner_step_s well below {half_period_s:.3g} s, half its period",
        )


def _parameters(model: RigModel, continuous: StateSpace, step_s: float, steps: int) -> Vector:
    parameters = np.concatenate([np.zeros(PARAMETERS), model.cogging.harmonics, model.cogging.ripple])
    parameters[STEP_S] = step_s
    parameters[STEPS] = steps
    parameters[EFFORT_LIMIT] = model.amplifier.effort_limit
    parameters[GRAVITY_EFFORT] = model.mechanics.gravity_effort
    parameters[COULOMB : COULOMB + len(continuous.friction)] = continuous.friction
    parameters[RESOLUTION] = model.encoder.resolution
    parameters[OFFSET] = model.encoder.offset
    parameters[SIGN] = model.encoder.sign
    parameters[MEAN] = cogging.mean_weight(step_s, model.amplifier.lag_s)
    parameters[RIPPLE] = PARAMETERS + len(model.cogging.harmonics)
    return parameters


@kernel(ADVANCE, inline=True, no_refcount=True)
def _advance_rigid(
    state: Vector, phi: Matrix, gamma: Matrix, parameters: Vector, command: float, external: float
) -> int:
    x, v, effort, age = state[0], state[1], state[2], state[3]
    step_s, coulomb = parameters[STEP_S], parameters[COULOMB]
    resolution, offset = parameters[RESOLUTION], parameters[OFFSET]
    push_x = gamma[0, 0] * command + gamma[0, 1] * external
    push_v = gamma[1, 0] * command + gamma[1, 1] * external
    push_e = gamma[2, 0] * command + gamma[2, 1] * external
    count = cell(x, resolution, offset)
    for _ in range(int(parameters[STEPS])):
        free = phi[1, 1] * v + phi[1, 2] * effort + push_v
        # Friction is held over the step, like the inputs, at the value that brings the mass to rest by its end, clipped
        # to the Coulomb level; static and kinetic level are equal. The price is a small error in a step in which the
        # mass stops or turns round: at most deceleration · step² / 8 in the length of a stop.
        friction, v_next = rub_one(free, gamma[1, 2], coulomb)
        x_next = x
        # A mass that is at rest and stays so keeps its position to the last bit: stuck means stuck, where a regularised
        # friction law would creep.
        if v != 0.0 or v_next != 0.0:
            x_next += phi[0, 1] * v + phi[0, 2] * effort + push_x + gamma[0, 2] * friction
        count, age = encode(count, age, x, x_next, step_s, resolution, offset)
        effort = phi[2, 1] * v + phi[2, 2] * effort + push_e + gamma[2, 2] * friction
        x, v = x_next, v_next
    state[0], state[1], state[2], state[3] = x, v, effort, age
    return count


@kernel(ADVANCE, inline=True, no_refcount=True)
def _advance_two_mass(
    state: Vector, phi: Matrix, gamma: Matrix, parameters: Vector, command: float, external: float
) -> int:
    """Move a plant with two masses by one tick; return the encoder count, without the encoder's sign."""
    x, v, y, w = state[0], state[1], state[2], state[3]  # motor and link: position, velocity
    effort, age = state[4], state[5]
    step_s, coulomb_v, coulomb_w = parameters[STEP_S], parameters[COULOMB], parameters[COULOMB_LINK]
    resolution, offset = parameters[RESOLUTION], parameters[OFFSET]
    push_x = gamma[0, 0] * command + gamma[0, 1] * external
    push_v = gamma[1, 0] * command + gamma[1, 1] * external
    push_y = gamma[2, 0] * command + gamma[2, 1] * external
    push_w = gamma[3, 0] * command + gamma[3, 1] * external
    push_e = gamma[4, 0] * command + gamma[4, 1] * external
    count = cell(x, resolution, offset)
    for _ in range(int(parameters[STEPS])):
        stretch = y - x
        free_v = phi[1, 1] * v + phi[1, 2] * stretch + phi[1, 3] * w + phi[1, 4] * effort + push_v
        free_w = phi[3, 1] * v + phi[3, 2] * stretch + phi[3, 3] * w + phi[3, 4] * effort + push_w
        rub_v, rub_w, v_next, w_next = rub_both(
            free_v, free_w, gamma[1, 2], gamma[3, 2], gamma[3, 3], coulomb_v, coulomb_w
        )
        x_next, y_next = x, y
        if v != 0.0 or v_next != 0.0:
            x_next += phi[0, 1] * v + phi[0, 2] * stretch + phi[0, 3] * w + phi[0, 4] * effort + push_x
            x_next += gamma[0, 2] * rub_v + gamma[0, 3] * rub_w
        if w != 0.0 or w_next != 0.0:
            y_next += phi[2, 1] * v - phi[2, 0] * stretch + phi[2, 3] * w + phi[2, 4] * effort + push_y
            y_next += gamma[2, 2] * rub_v + gamma[2, 3] * rub_w
        count, age = encode(count, age, x, x_next, step_s, resolution, offset)
        effort = phi[4, 1] * v + phi[4, 2] * stretch + phi[4, 3] * w + phi[4, 4] * effort + push_e
        effort += gamma[4, 2] * rub_v + gamma[4, 3] * rub_w
        x, v, y, w = x_next, v_next, y_next, w_next
    state[0], state[1], state[2], state[3] = x, v, y, w
    state[4], state[5] = effort, age
    return count


_callback = ctypes.CFUNCTYPE(None)(lambda: None)
_address = ctypes.cast(_callback, ctypes.c_void_p).value
assert _address is not None
_NO_HAND = NativeFunction(_address, ADVANCE, keep=_callback)  # a plug point cannot be null
_OTHER = {  # function that moves a plant, by its states
    RIGID_ORDER: _NO_HAND,  # never called
    TWO_MASS_ORDER: _NO_HAND,
    RIGID_ORDER + HAND_ORDER: coupled_hand.advance_rigid,
    TWO_MASS_ORDER + HAND_ORDER: coupled_hand.advance_two_mass,
}


@kernel(types.int64(PLANT_TYPE, types.float64, types.float64), inline=True)
def advance(plant: PlantArguments, command_effort: float, external_effort: float) -> int:
    """Move a plant by one tick; return the encoder count at its end.

    Parameters
    ----------
    plant
        From `DiscretePlant.arguments`; its state is changed in place.
    command_effort
        Effort commanded to the amplifier in this tick (N·m or N, finite). It acts `delay_ticks` ticks later, clipped
        to the effort limit and filtered by the electrical lag.
    external_effort
        External effort on the link during the tick (N·m or N, finite).
    """
    # Inlined into compiled callers: counting references to its arrays would cost more than a step.
    state, phi, gamma, parameters = plant.state, plant.phi, plant.gamma, plant.parameters
    order = phi.shape[0]
    active = command_effort
    last = state.shape[0] - 1
    if last > order:
        active = state[order + 1]
        for i in range(order + 1, last):
            state[i] = state[i + 1]
        state[last] = command_effort
    active = clip(active, parameters[EFFORT_LIMIT])
    external = external_effort + parameters[GRAVITY_EFFORT]
    if order == RIGID_ORDER:
        count = _advance_rigid(state, phi, gamma, parameters, active, external)
    elif order == TWO_MASS_ORDER:
        count = _advance_two_mass(state, phi, gamma, parameters, active, external)
    else:
        count = plant.other(state, phi, gamma, parameters, active, external)
    return int(parameters[SIGN]) * count
