"""Physics of a rig as data: mechanics, amplifier, encoder, and the continuous state space model that follows.

This file does no time stepping: `sim_backend.mechanics.plant` discretises and simulates this model, and theory uses the
same matrices. Everything is referred to the link (the moving side that a person holds), in SI units; for a linear rig
read mass for inertia and force for effort.

State of the continuous model, in this order:

* two-mass: motor position, motor velocity, link position, link velocity, motor effort
* rigid: position, velocity, motor effort
* coupled to a person's hand: hand position and hand velocity after the others

Inputs, in this order: commanded effort, external effort on the link, then one Coulomb friction effort for each mass;
with a person then the intended position, the intended velocity and the press force on the hand. Saturation, gravity and
computation delay are no part of the matrices.

Theory, identification, experiment files, devices, firmware, drives and the simulation read it. They index the matrices
by the order of states and inputs, so a change of this order must include all of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt, MinLen
from numpy.typing import ArrayLike, NDArray

from rig.core.quantity import STRICT, Quantity
from rig.core.sample import Motion

Matrix = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class Mechanics:
    """Mechanics of a rig, referred to the link: inertias, friction, and the transmission between motor and link."""

    structure: Annotated[
        Literal["rigid", "two-mass"],
        Quantity("", "one inertia, or motor and link joined by the elastic capstan"),
    ]
    motor_inertia: Annotated[
        float, Gt(0), Quantity("inertia", "rotor and pinion, times the square of the ratio")
    ]
    link_inertia: Annotated[float, Ge(0), Quantity("inertia", "link and handle, without the end mass")]
    motor_damping: Annotated[float, Ge(0), Quantity("damping", "viscous damping of the motor side")] = 0.0
    link_damping: Annotated[float, Ge(0), Quantity("damping", "viscous damping of the link side")] = 0.0
    motor_coulomb: Annotated[float, Ge(0), Quantity("effort", "Coulomb friction of the motor side")] = 0.0
    link_coulomb: Annotated[float, Ge(0), Quantity("effort", "Coulomb friction of the link side")] = 0.0
    transmission_stiffness: Annotated[
        float, Ge(0), Quantity("stiffness", "capstan stiffness (two-mass only)")
    ] = 0.0
    transmission_damping_ratio: Annotated[
        float, Ge(0), Lt(1), Quantity("1", "damping ratio of the free-free mode (two-mass only)")
    ] = 0.0
    handle_radius: Annotated[float, Gt(0), Quantity("m", "lever arm of the handle; 1 for a linear rig")] = 1.0
    end_mass: Annotated[float, Ge(0), Quantity("kg", "extra mass at the handle for automated trials")] = 0.0
    gravity: Annotated[
        float,
        Ge(-20),
        Le(20),
        Quantity("m/s²", "gravity along the motion, acting on the end mass; 0 for a level rig"),
    ] = 0.0

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT

    def __post_init__(self) -> None:
        two_mass = self.structure == "two-mass"
        if two_mass and not (self.transmission_stiffness > 0.0 and self.loaded_link_inertia > 0.0):
            raise ValueError("a two-mass rig needs transmission_stiffness and link_inertia above zero")

    @property
    def loaded_link_inertia(self) -> float:
        """Return the inertia of link and end mass (kg·m² or kg)."""
        return self.link_inertia + self.end_mass * self.handle_radius**2

    @property
    def inertia(self) -> float:
        """Return the inertia of motor, link and end mass together (kg·m² or kg)."""
        return self.motor_inertia + self.loaded_link_inertia

    @property
    def gravity_effort(self) -> float:
        """Return the constant effort (N·m or N) of the end mass's weight on the link, positive along the motion."""
        return self.end_mass * self.gravity * self.handle_radius

    @property
    def transmission_damping(self) -> float:
        """Return the viscous damping between motor and link (N·m·s/rad or N·s/m).

        It follows from `transmission_damping_ratio`, the damping ratio of the mode in which motor and link oscillate
        freely.
        """
        # Without the end mass: a mass on the handle changes no property of the cable.
        reduced = self.motor_inertia * self.link_inertia / (self.motor_inertia + self.link_inertia)
        return 2.0 * self.transmission_damping_ratio * math.sqrt(self.transmission_stiffness * reduced)


@dataclass(frozen=True, kw_only=True, slots=True)
class Amplifier:
    """Motor and amplifier: how a commanded current becomes an effort at the link."""

    effort_per_ampere: Annotated[
        float, Gt(0), Quantity("effort/A", "torque constant times transmission ratio")
    ]
    effort_limit: Annotated[float, Gt(0), Quantity("effort", "largest effort of the motor (stall)")]
    lag_s: Annotated[float, Ge(0), Lt(0.1), Quantity("s", "first-order electrical lag; 0 for none")] = 0.0
    current_quantum_a: Annotated[
        float, Gt(0), Quantity("A", "one step of the current command and of its measurement")
    ] = 0.001
    drive: Annotated[
        Literal["current", "voltage"],
        Quantity(
            "",
            "current: closed current loop; voltage: open voltage (PWM) drive, whose back-EMF brakes "
            "with the lag",
        ),
    ] = "current"
    back_emf_damping: Annotated[
        float,
        Ge(0),
        Quantity("damping", "k_t²/R at the link: braking of a steady motion under voltage drive"),
    ] = 0.0
    current_monitor: Annotated[
        bool, Quantity("", "the device measures the motor's current, which is compared with the set current")
    ] = True
    current_noise_a: Annotated[
        float, Ge(0), Quantity("A", "rms noise of the current sensor, without its quantisation")
    ] = 0.0
    profile: Annotated[
        str, MinLen(1), Quantity("", "name of the amplifier's profile, from `rig firmware amplifiers`")
    ] = "generic"
    set_point_delay_s: Annotated[
        float,
        Ge(0),
        Lt(0.01),
        Quantity(
            "s",
            "delay from a set-point to the amplifier's response (one PWM period); rounded up to whole ticks",
        ),
    ] = 0.0

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT

    @property
    def effort_quantum(self) -> float:
        """Return the effort (N·m or N) of one current quantum, the smallest step of the commanded current."""
        return self.effort_per_ampere * self.current_quantum_a

    @property
    def back_emf(self) -> float:
        """Return the damping by back-EMF (N·m·s/rad or N·s/m), which acts after the lag; 0 under current drive."""
        return self.back_emf_damping if self.drive == "voltage" else 0.0

    def set_point_ticks(self, tick_s: float) -> int:
        """Return the delay from a set-point to the amplifier's response in ticks of `tick_s` (s), rounded up."""
        # Without the margin 250 µs in ticks of 50 µs would be 6: the quotient of two decimals is 5.000…1.
        return math.ceil(self.set_point_delay_s / tick_s - 1e-9)


@dataclass(frozen=True, kw_only=True, slots=True)
class Cogging:
    """Cogging and torque ripple of the motor, as sums of harmonics over position, referred to the link.

    Cogging is an effort that depends only on position x: effort(x) = Σ cosine·cos(order·2π·x/period) +
    sine·sin(order·2π·x/period). Any periodic effort has this form, for example between magnets and slots.
    Without orders there is no cogging.

    Ripple is a variation of the torque constant: the motor's effort is (1 + r(x)) times the commanded effort, where r
    is a sum of harmonics of the same orders. Without ripple coefficients, r is 0.
    """

    period: Annotated[
        float | None,
        Gt(0),
        Quantity(
            "position",
            "travel after which the cogging repeats: one turn of the motor, at the link, or the "
            "pitch of the magnets",
        ),
    ] = None
    orders: Annotated[tuple[int, ...], Quantity("", "numbers of the harmonics that are present")] = ()
    cosine: Annotated[
        tuple[float, ...],
        Quantity("effort", "amplitude of each harmonic's cosine, in phase with position zero"),
    ] = ()
    sine: Annotated[
        tuple[float, ...], Quantity("effort", "amplitude of each harmonic's sine, a quarter of a wave later")
    ] = ()
    ripple_cosine: Annotated[
        tuple[float, ...], Quantity("1", "relative variation of the motor's effort, cosine of each harmonic")
    ] = ()
    ripple_sine: Annotated[
        tuple[float, ...], Quantity("1", "relative variation of the motor's effort, sine of each harmonic")
    ] = ()
    minimum: Annotated[
        float | None, Quantity("position", "lower end of the range in which this was measured")
    ] = None
    maximum: Annotated[
        float | None, Quantity("position", "upper end of the range in which this was measured")
    ] = None

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT

    @property
    def harmonics(self) -> NDArray[np.float64]:
        """Return wavenumber (rad per rad or m), cosine and sine (N·m or N) of each cogging harmonic, as flat array."""
        return self._rows(self.cosine, self.sine)

    @property
    def ripple(self) -> NDArray[np.float64]:
        """Return wavenumber (rad per rad or m), cosine and sine (ratios) of each ripple harmonic, flat, or empty."""
        return self._rows(self.ripple_cosine, self.ripple_sine) if self.ripple_cosine else np.empty(0)

    def _rows(self, cosine: tuple[float, ...], sine: tuple[float, ...]) -> NDArray[np.float64]:
        wave = 2.0 * math.pi / (self.period or math.inf)
        rows = [(wave * n, c, s) for n, c, s in zip(self.orders, cosine, sine, strict=True)]
        return np.array(rows, dtype=np.float64).ravel()

    @property
    def ripple_crest(self) -> float:
        """Return an upper bound of the torque ripple (ratio to the effort): the sum of all harmonics' amplitudes."""
        return math.fsum(math.hypot(c, s) for c, s in zip(self.ripple_cosine, self.ripple_sine, strict=True))

    @property
    def crest(self) -> float:
        """Return an upper bound of the cogging effort (N·m or N): the sum of all harmonics' amplitudes."""
        # Not the largest value of the sum, which would need a search: the crests need not lie at one place.
        return math.fsum(math.hypot(c, s) for c, s in zip(self.cosine, self.sine, strict=True))

    def effort(self, position: ArrayLike) -> NDArray[np.float64]:
        """Return the cogging effort (N·m or N) at each position (rad or m)."""
        return _sum_harmonics(self.harmonics, position)

    def share(self, position: ArrayLike) -> NDArray[np.float64]:
        """Return the torque ripple at each position (rad or m): the ratio motor effort / commanded effort, minus 1."""
        return _sum_harmonics(self.ripple, position)

    def slope(self, position: ArrayLike) -> NDArray[np.float64]:
        """Return d(cogging effort)/dx (N·m/rad or N/m) at each position: minus the stiffness of the cogging."""
        k, c, s = self.harmonics.reshape(-1, 3).T
        angle = np.multiply.outer(np.asarray(position, dtype=np.float64), k)
        return np.asarray(np.cos(angle) @ (k * s) - np.sin(angle) @ (k * c))

    def energy(self, position: ArrayLike) -> NDArray[np.float64]:
        """Return the cogging's potential energy (J) at each position (rad or m), with mean 0; effort = −dE/dx."""
        k, c, s = self.harmonics.reshape(-1, 3).T
        angle = np.multiply.outer(np.asarray(position, dtype=np.float64), k)
        return np.asarray(np.cos(angle) @ (s / k) - np.sin(angle) @ (c / k))


def _sum_harmonics(harmonics: NDArray[np.float64], position: ArrayLike) -> NDArray[np.float64]:
    k, c, s = harmonics.reshape(-1, 3).T
    angle = np.multiply.outer(np.asarray(position, dtype=np.float64), k)
    return np.asarray(np.cos(angle) @ c + np.sin(angle) @ s)


@dataclass(frozen=True, kw_only=True, slots=True)
class Encoder:
    """Incremental encoder on the motor side.

    A rotary encoder is given by `counts_per_revolution`, `decoding` and `ratio`; a linear one by `quantum`. A position
    reads as ``sign · floor(position / resolution + offset)`` counts.
    """

    counts_per_revolution: Annotated[int | None, Quantity("1", "lines of the encoder disc")] = None
    decoding: Annotated[Literal[1, 4], Quantity("1", "edges counted for each line: ×1 or ×4")] = 4
    ratio: Annotated[float, Gt(0), Quantity("1", "encoder revolutions for one revolution of the link")] = 1.0
    quantum: Annotated[float | None, Quantity("m", "travel for one count of a linear encoder")] = None
    offset: Annotated[
        float, Ge(0), Lt(1), Quantity("count", "place of position zero between two edges (simulation)")
    ] = 0.5
    sign: Annotated[Literal[-1, 1], Quantity("1", "-1 when counts fall while the position rises")] = 1

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT

    def __post_init__(self) -> None:
        given = [size for size in (self.counts_per_revolution, self.quantum) if size is not None]
        if len(given) != 1 or not given[0] > 0:
            raise ValueError("an encoder needs either counts_per_revolution or quantum, above zero")

    @property
    def resolution(self) -> float:
        """Return the travel of the link for one encoder count (rad or m)."""
        if self.counts_per_revolution is None:
            assert self.quantum is not None
            return self.quantum
        return 2.0 * math.pi / (self.counts_per_revolution * self.decoding * self.ratio)


@dataclass(frozen=True, kw_only=True, slots=True)
class Reference:
    """Reference of position zero in the mechanism: the encoder's index, and a limit switch that selects one index.

    An incremental encoder counts from the position at power-up. Its index occurs once per turn, so it identifies a
    position only if the travel contains a single index, or together with a limit switch.
    """

    index: Annotated[bool, Quantity("", "the encoder has an index, and it is wired")] = False
    position: Annotated[
        float,
        Quantity(
            "position", "position of the index; with a limit switch, of the first index on the way from it"
        ),
    ] = 0.0
    limit_switch: Annotated[
        Literal["none", "minimum", "maximum"],
        Quantity(
            "",
            "end of the travel with a limit switch; normally closed, so that a broken wire reads as pressed",
        ),
    ] = "none"
    travel: Annotated[
        float | None,
        Gt(0),
        Quantity("position", "travel of the handle from stop to stop; needed with an index"),
    ] = None
    index_distance: Annotated[
        float | None,
        Gt(0),
        Quantity("position", "distance from one index to the next; left out: one turn of a rotary encoder"),
    ] = None

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT

    @property
    def away(self) -> int:
        """Return the sign of motion away from the limit switch (1 or -1); 0 without a limit switch."""
        return {"none": 0, "minimum": 1, "maximum": -1}[self.limit_switch]

    def index_counts(self, encoder: Encoder) -> int:
        """Return the encoder counts from one index pulse to the next; 0 without an index or with unknown distance."""
        if not self.index:
            return 0
        if self.index_distance is not None:
            return round(self.index_distance / encoder.resolution)
        return (encoder.counts_per_revolution or 0) * encoder.decoding


@dataclass(frozen=True, kw_only=True, slots=True)
class Simulation:
    """Settings of a simulated rig: initial position, longest integration step, and delay of a command's effort."""

    initial_position: Annotated[
        float | None, Quantity("position", "where the handle rests at power-up; left out: 0")
    ] = None
    inner_step_s: Annotated[
        float,
        Gt(0),
        Le(1e-3),
        Quantity("s", "longest integration step of the plant; a tick is a whole number of steps"),
    ] = 5e-5
    computation_delay_ticks: Annotated[
        int, Ge(0), Le(100), Quantity("1", "whole ticks between a command and its effort")
    ] = 0

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class Operator:
    """A simulated person who holds the handle: finger pads, a hand behind them, and what the hand does in a trial.

    The pads (spring and damper, with their mass on the link) couple the link to the hand. A spring and a damper pull
    the hand to its intended position, and the hand presses into the wall. All numbers are at the handle, for rotary
    rigs too: `Mechanics.handle_radius` converts them. `rig.core.operators` has numbers for three grips.
    """

    grip: Annotated[
        Literal["relaxed", "normal", "firm"],
        Quantity("", "grip of the handle; it decides every operator parameter that is not set"),
    ]
    pads_mass: Annotated[float, Ge(0), Quantity("kg", "finger pads, which move with the handle")]
    pads_stiffness: Annotated[float, Ge(0), Quantity("N/m", "pads between handle and hand")]
    pads_damping: Annotated[float, Ge(0), Quantity("N·s/m", "pads between handle and hand")]
    hand_mass: Annotated[float, Gt(0), Quantity("kg", "hand behind the pads")]
    hand_stiffness: Annotated[float, Ge(0), Quantity("N/m", "hand to its intended position")]
    hand_damping: Annotated[float, Ge(0), Quantity("N·s/m", "hand to its intended velocity")]
    press: Annotated[
        float, Ge(0), Quantity("N", "press of the hand into the wall; it ramps in with the reach")
    ]
    press_modulation: Annotated[
        float, Ge(0), Lt(1), Quantity("1", "share of the press by which it slowly swells and ebbs")
    ]
    tremor: Annotated[
        float,
        Ge(0),
        Le(0.01),
        Quantity("m", "rms tremor of the intended position; it ramps in with the reach"),
    ]
    depth: Annotated[float, Gt(0), Quantity("m", "how far inside the wall the intended position ends")]
    begin_s: Annotated[
        float, Ge(0), Le(60), Quantity("s", "pause at the start of the trial before the reach begins")
    ]
    reach_s: Annotated[float, Gt(0), Le(60), Quantity("s", "duration of the reach")]

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, kw_only=True, slots=True)
class OperatorReach:
    """Movement that a simulated person intends in one trial: to the start, a wait, and then into the wall."""

    start: float  # where the trial begins (rad or m)
    target: float  # where the intended position ends, inside the wall (rad or m)
    pace: float  # at which the hand goes along with the homing servo (rad/s or m/s)
    wait_s: float  # from the arrival at the start to the beginning of the reach
    free_s: float = 0.0  # the last part of that, in which the handle only has to stay off the wall
    seed: int  # of the tremor's phases


@dataclass(frozen=True, kw_only=True, slots=True)
class RigModel:
    """Complete description of a rig, from which it can be simulated.

    With an `operator` a simulated person holds the handle: still, or with the intended movement `reach`. `board` lists
    settings (name, value) with which the firmware of the board must have been built.
    """

    name: str
    motion: Motion
    mechanics: Mechanics
    amplifier: Amplifier
    encoder: Encoder
    simulation: Simulation = field(default_factory=Simulation)
    reference: Reference = field(default_factory=Reference)
    cogging: Cogging = field(default_factory=Cogging)
    operator: Operator | None = None
    reach: OperatorReach | None = None
    board: tuple[tuple[str, bool | int | float | str], ...] = ()

    @property
    def damping(self) -> float:
        """Return the viscous damping of slow rigid motion (N·m·s/rad or N·s/m): motor, link and back-EMF.

        Above the frequency 1/(2π·lag) the damping by back-EMF decreases, because its current lags behind.
        """
        return self.mechanics.motor_damping + self.mechanics.link_damping + self.amplifier.back_emf

    def delay_ticks(self, tick_s: float) -> int:
        """Return the delay from a command to its effort, in ticks of `tick_s` (s): computation plus set-point delay."""
        return self.simulation.computation_delay_ticks + self.amplifier.set_point_ticks(tick_s)

    def held_by(self, operator: Operator | None, reach: OperatorReach | None) -> RigModel:
        """Return a copy of the rig with a simulated person and no end mass; the rig itself if `operator` is None."""
        if operator is None:
            return self
        bare = replace(self.mechanics, end_mass=0.0)
        return replace(self, mechanics=bare, operator=operator, reach=reach)


@dataclass(frozen=True, slots=True)
class StateSpace:
    """Continuous state space model ẋ = A x + B u of a rig, with the indices of its states (see `rig.core.model`)."""

    a: Matrix
    b: Matrix
    sensed_position: int
    handle_position: int
    effort: int
    friction: tuple[float, ...]  # Coulomb level of each friction input, in input order
    friction_velocity: tuple[int, ...]  # state index of the velocity that each friction input opposes
    back_emf: float  # what a unit of motor velocity takes off the effort, in the end
    hand_position: int | None = None  # of the operator, if there is one

    @property
    def order(self) -> int:
        """Return the number of states of the model."""
        return int(self.a.shape[0])

    @property
    def friction_inputs(self) -> slice:
        """Return the columns of ``b`` (inputs) through which Coulomb friction acts, one for each mass."""
        return slice(2, 2 + len(self.friction))

    @property
    def operator_inputs(self) -> slice:
        """Return the columns of ``b`` for a person's intended position, velocity and press; empty without a person."""
        return slice(2 + len(self.friction), int(self.b.shape[1]))


def state_space(mechanics: Mechanics, amplifier: Amplifier, operator: Operator | None = None) -> StateSpace:
    """Return the continuous state space model of a rig, optionally held by a simulated person.

    Parameters
    ----------
    mechanics, amplifier
        Mechanics and amplifier of the rig.
    operator
        Person who holds the handle, or None.

    Returns
    -------
    StateSpace
        ``a`` is order × order, ``b`` is order × inputs; SI units.

    Notes
    -----
    The effort state is k_t times the current that flows. With an electrical lag (L/R under voltage drive) it obeys
    lag_s · effort' = command − back_emf · motor velocity − effort; back_emf is 0 under current drive. Without a lag
    (``lag_s = 0``) no finite matrix lets the effort state follow at once: the command then drives the velocity
    directly, the back-EMF damps the motor, and the effort state is not connected, its rows and column zero (the plant
    writes into it).

    An operator adds the pads' mass to the link and two states. With k₁, b₁ of the pads and m, k₂, b₂ of the hand,
    referred to the link, y the handle and h the hand: m h″ = k₁(y − h) + b₁(y′ − h′) + k₂(intended position − h) +
    b₂(intended velocity − h′) + press, and on the link acts k₁(h − y) + b₁(h′ − y′).

    Source: Koul et al. 2013, section III (capstan drive 10:1, non-collocated hinge).
    """
    pads = 0.0 if operator is None else operator.pads_mass * mechanics.handle_radius**2
    link = mechanics.loaded_link_inertia + pads
    free = (_build_rigid if mechanics.structure == "rigid" else _build_two_mass)(mechanics, amplifier, link)
    if operator is None:
        return free
    moved = link + (mechanics.motor_inertia if mechanics.structure == "rigid" else 0.0)
    return _couple_hand(free, operator, mechanics.handle_radius, moved)


def _build_rigid(mechanics: Mechanics, amplifier: Amplifier, link: float) -> StateSpace:
    inertia = mechanics.motor_inertia + link
    coulomb = mechanics.motor_coulomb + mechanics.link_coulomb
    a, b = np.zeros((3, 3)), np.zeros((3, 3))
    a[0, 1] = 1.0
    a[1, 1] = -(mechanics.motor_damping + mechanics.link_damping) / inertia
    b[1, 1] = b[1, 2] = 1.0 / inertia
    _connect_effort(a, b, amplifier, effort=2, inertia=inertia)
    return StateSpace(
        a,
        b,
        sensed_position=0,
        handle_position=0,
        effort=2,
        friction=(coulomb,),
        friction_velocity=(1,),
        back_emf=amplifier.back_emf,
    )


def _build_two_mass(mechanics: Mechanics, amplifier: Amplifier, link: float) -> StateSpace:
    k, c, motor = mechanics.transmission_stiffness, mechanics.transmission_damping, mechanics.motor_inertia
    a, b = np.zeros((5, 5)), np.zeros((5, 4))
    a[0, 1] = a[2, 3] = 1.0
    a[1, :4] = np.array([-k, -c - mechanics.motor_damping, k, c]) / motor
    a[3, :4] = np.array([k, c, -k, -c - mechanics.link_damping]) / link
    b[3, 1] = b[3, 3] = 1.0 / link
    b[1, 2] = 1.0 / motor
    _connect_effort(a, b, amplifier, effort=4, inertia=motor)
    coulomb = (mechanics.motor_coulomb, mechanics.link_coulomb)
    return StateSpace(
        a,
        b,
        sensed_position=0,
        handle_position=2,
        effort=4,
        friction=coulomb,
        friction_velocity=(1, 3),
        back_emf=amplifier.back_emf,
    )


def _couple_hand(free: StateSpace, operator: Operator, radius: float, handle_inertia: float) -> StateSpace:
    rows, columns = free.b.shape
    y, h = free.handle_position, rows
    a, b = np.zeros((rows + 2, rows + 2)), np.zeros((rows + 2, columns + 3))
    a[:rows, :rows], b[:rows, :columns] = free.a, free.b
    pads = radius**2 * np.array([operator.pads_stiffness, operator.pads_damping])
    hand = radius**2 * np.array([operator.hand_stiffness, operator.hand_damping])
    mass = operator.hand_mass * radius**2
    a[y + 1, y : y + 2] -= pads / handle_inertia
    a[y + 1, h : h + 2] = pads / handle_inertia
    a[h, h + 1] = 1.0
    a[h + 1, y : y + 2] = pads / mass
    a[h + 1, h : h + 2] = -(pads + hand) / mass
    b[h + 1, columns:] = [*hand / mass, 1.0 / mass]
    return replace(free, a=a, b=b, hand_position=h)


def _connect_effort(a: Matrix, b: Matrix, amplifier: Amplifier, *, effort: int, inertia: float) -> None:
    motor_velocity, lag = 1, amplifier.lag_s
    if lag > 0.0:
        a[effort, effort] = -1.0 / lag
        a[effort, motor_velocity] = -amplifier.back_emf / lag
        b[effort, 0] = 1.0 / lag
        a[motor_velocity, effort] = 1.0 / inertia
    else:
        a[motor_velocity, motor_velocity] -= amplifier.back_emf / inertia
        b[motor_velocity, 0] = 1.0 / inertia
