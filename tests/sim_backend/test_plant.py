"""The simulated plant against closed forms, independent integrators and the laws of mechanics."""

import ctypes
import math
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from rig.core.errors import ConfigError
from rig.core.model import Amplifier, Encoder, Mechanics, Operator, RigModel, Simulation, state_space
from rig.core.operators import GRIPS
from sim_backend.board.firmware_library import FIRMWARE
from sim_backend.mechanics import plant as plants
from sim_backend.mechanics.inner import STEP_S, STEPS, rub_both
from sim_backend.mechanics.plant import DiscretePlant, advance
from tests.conformance.firmware import need_compiler

Trajectory = NDArray[np.float64]

MOTOR, MOTOR_VELOCITY, LINK, LINK_VELOCITY = 0, 1, 2, 3
TICK_S = 5e-5

# Chawda's linear rig (0.52 kg, 13.2 N·s/m, 1 µm), here without friction: each test adds what it is about.
LINEAR = RigModel(
    name="linear",
    motion="linear",
    mechanics=Mechanics(structure="rigid", motor_inertia=0.5, link_inertia=0.02),
    amplifier=Amplifier(effort_per_ampere=10.0, effort_limit=100.0),
    encoder=Encoder(quantum=1e-6),
)
# Koul's rotary rig with the compliant capstan.
ROTARY = RigModel(
    name="rotary",
    motion="rotary",
    mechanics=Mechanics(
        structure="two-mass",
        motor_inertia=1.9e-4,
        link_inertia=1.58e-3,
        motor_damping=2.7e-3,
        link_damping=1e-3,
        motor_coulomb=0.005,
        link_coulomb=0.0017,
        transmission_stiffness=2310.0,
        transmission_damping_ratio=0.035,
        handle_radius=0.1,
    ),
    amplifier=Amplifier(effort_per_ampere=0.234, effort_limit=1.3, lag_s=1e-4),
    encoder=Encoder(counts_per_revolution=1000, ratio=10.0),
)
FRICTIONLESS = {"motor_coulomb": 0.0, "link_coulomb": 0.0}


def with_mechanics(rig: RigModel, **changes: Any) -> RigModel:
    return replace(rig, mechanics=replace(rig.mechanics, **changes))


def with_amplifier(rig: RigModel, **changes: Any) -> RigModel:
    return replace(rig, amplifier=replace(rig.amplifier, **changes))


def with_simulation(rig: RigModel, **changes: Any) -> RigModel:
    return replace(rig, simulation=Simulation(**changes))


def run(
    plant: DiscretePlant, ticks: int, *, state: Trajectory, command: float = 0.0, external: float = 0.0
) -> Trajectory:
    """Return the states at the end of each tick under constant inputs; `state` is the start and is changed."""
    rows, moving = np.empty((ticks, state.size)), plant.arguments(state)
    for row in rows:
        advance(moving, command, external)
        row[:] = state
    return rows


CAPSTAN = with_mechanics(ROTARY, motor_damping=0.0, link_damping=0.0, **FRICTIONLESS)


# The linear part -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rig", [LINEAR, ROTARY], ids=["rigid", "two-mass"])
@pytest.mark.parametrize("operator", [None, GRIPS["normal"]], ids=["free", "held"])
@pytest.mark.parametrize(
    ("lag_s", "tick_s", "inner_step_s"),
    [(0.0, 5e-5, 5e-5), (2e-4, 5e-5, 5e-5), (0.0, 1e-3, 3e-4), (2e-4, 1e-3, 5e-5)],
)
def test_without_friction_the_motion_is_that_of_an_independent_solver(
    rig: RigModel, operator: Operator | None, lag_s: float, tick_s: float, inner_step_s: float
) -> None:
    rig = with_mechanics(with_amplifier(rig, lag_s=lag_s), motor_damping=0.004, **FRICTIONLESS)
    rig = rig.held_by(operator, None)
    plant = DiscretePlant.build(with_simulation(rig, inner_step_s=inner_step_s), tick_s)
    continuous = state_space(rig.mechanics, rig.amplifier, operator)
    start = 0.01 * np.random.default_rng(7).standard_normal(continuous.order)
    inputs = np.zeros(continuous.b.shape[1])
    inputs[:2] = 0.4, -0.3
    inputs[continuous.operator_inputs] = (0.02, -0.1, 0.3) if operator else ()
    if lag_s == 0.0:
        start[continuous.effort] = inputs[0]

    ticks = round(0.02 / tick_s)
    state = plant.at_rest(0.0)
    state[: continuous.order] = start
    state[plant.intentions] = inputs[continuous.operator_inputs]
    end = run(plant, ticks, state=state, command=inputs[0], external=inputs[1])[-1]
    solved = solve_ivp(
        lambda _, x: continuous.a @ x + continuous.b @ inputs,
        (0.0, 0.02),
        start,
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
    )
    assert end[: continuous.order] == pytest.approx(solved.y[:, -1], rel=1e-8, abs=1e-11)


@pytest.mark.parametrize("rig", [LINEAR, ROTARY], ids=["rigid", "two-mass"])
@pytest.mark.parametrize("operator", [None, GRIPS["normal"]], ids=["free", "held"])
@pytest.mark.parametrize("lag_s", [0.0, 2e-4])
def test_voltage_drive_subtracts_the_back_emf(rig: RigModel, operator: Operator | None, lag_s: float) -> None:
    """Check against an independent solver with the effort lag·T′ = command − b·ω − T."""
    emf = 0.05
    rig = with_mechanics(rig, motor_damping=0.004, **FRICTIONLESS).held_by(operator, None)
    plant = DiscretePlant.build(with_amplifier(rig, lag_s=lag_s, drive="voltage", back_emf_damping=emf), 1e-4)
    free = state_space(rig.mechanics, replace(rig.amplifier, lag_s=1.0, drive="current"), operator)
    e, command, external = free.effort, 0.4, -0.3
    inputs = np.zeros(free.b.shape[1])
    inputs[1] = external

    def slope(_: float, x: Any) -> Any:
        flowing = command - emf * x[1] if lag_s == 0.0 else x[e]
        at = x.copy()
        at[e] = flowing
        moved = free.a @ at + free.b @ inputs
        moved[e] = 0.0 if lag_s == 0.0 else (command - emf * x[1] - x[e]) / lag_s
        return moved

    end = run(plant, 200, state=plant.at_rest(0.0), command=command, external=external)[-1]
    solved = solve_ivp(slope, (0.0, 0.02), np.zeros(free.order), method="DOP853", rtol=1e-12, atol=1e-14)
    wanted = solved.y[:, -1]
    if lag_s == 0.0:
        wanted[e] = command - emf * wanted[1]
    assert end[: free.order] == pytest.approx(wanted, rel=1e-7, abs=1e-11)
    assert end[e] != command


def test_one_tick_of_twenty_steps_is_twenty_ticks_of_one_step_to_the_last_bit() -> None:
    slow, fast = DiscretePlant.build(ROTARY, 1e-3), DiscretePlant.build(ROTARY, 5e-5)
    assert (slow.parameters[STEPS], fast.parameters[STEPS]) == (20, 1)
    assert slow.parameters[STEP_S] == fast.parameters[STEP_S]
    one, other = slow.at_rest(0.1), fast.at_rest(0.1)
    for k in range(50):
        push = 0.2 * math.sin(0.4 * k)
        run(slow, 1, state=one, command=push, external=-0.5 * push)
        run(fast, 20, state=other, command=push, external=-0.5 * push)
        assert one.tobytes() == other.tobytes()


def test_the_inner_step_divides_the_tick_and_is_never_longer_than_asked() -> None:
    for tick_s in (5e-5, 7.3e-5, 1e-4, 1 / 3000, 1e-3, 0.01):
        plant = DiscretePlant.build(ROTARY, tick_s)
        step_s, steps = plant.parameters[STEP_S], plant.parameters[STEPS]
        assert step_s <= 5e-5 * (1 + 1e-9)
        assert step_s * steps == pytest.approx(tick_s)
        assert steps == 1 or tick_s / (steps - 1) > 5e-5


# Amplifier -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_command_beyond_the_limit_acts_as_the_limit_before_the_lag(sign: float) -> None:
    plant = DiscretePlant.build(ROTARY, TICK_S)
    beyond = run(plant, 100, state=plant.at_rest(0.0), command=sign * 40.0)
    at_limit = run(plant, 100, state=plant.at_rest(0.0), command=sign * 1.3)
    assert beyond.tobytes() == at_limit.tobytes()
    # The lag starts from the limit, not from the command: never beyond it, but for the rounding of 100 ticks.
    assert np.abs(beyond[:, plant.effort]).max() <= 1.3 * (1.0 + 1e-12)


@pytest.mark.parametrize("delay_ticks", [1, 2, 7])
def test_a_computation_delay_shifts_the_response_by_whole_ticks(delay_ticks: int) -> None:
    def respond(rig: RigModel) -> Trajectory:
        plant = DiscretePlant.build(rig, TICK_S)
        state = plant.at_rest(0.02)
        rows = [run(plant, 1, state=state, command=0.2 * math.cos(0.1 * k))[0] for k in range(60)]
        return np.array(rows)[:, : plant.edge_age]

    at_once = respond(ROTARY)
    delayed = respond(with_simulation(ROTARY, computation_delay_ticks=delay_ticks))
    assert (delayed[:delay_ticks, :4] == [0.02, 0.0, 0.02, 0.0]).all()
    assert delayed[delay_ticks:].tobytes() == at_once[:-delay_ticks].tobytes()


@pytest.mark.parametrize(
    ("delay_s", "ticks"), [(TICK_S, 1), (0.2 * TICK_S, 1), (5 * TICK_S, 5), (5.1 * TICK_S, 6)]
)
def test_a_set_point_delay_is_rounded_up_to_ticks_beside_the_computation(delay_s: float, ticks: int) -> None:
    late = with_amplifier(with_simulation(ROTARY, computation_delay_ticks=2), set_point_delay_s=delay_s)
    assert late.delay_ticks(TICK_S) == DiscretePlant.build(late, TICK_S).delay_ticks == 2 + ticks
    assert late.delay_ticks(TICK_S / 10) == 2 + round(10 * delay_s / TICK_S)


def test_zeroing_the_commands_on_their_way_cuts_the_effort_of_a_delayed_plant() -> None:
    rig = with_amplifier(with_simulation(LINEAR, computation_delay_ticks=3), lag_s=0.0)
    plant = DiscretePlant.build(rig, TICK_S)
    state = plant.at_rest(0.0)
    run(plant, 10, state=state, command=5.0)
    assert (state[plant.commands] == 5.0).all()
    state[plant.commands] = 0.0
    assert run(plant, 1, state=state)[0, plant.effort] == 0.0


# Steady states ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("structure", ["rigid", "two-mass"])
def test_the_end_mass_falls_and_an_equal_effort_holds_it(structure: str) -> None:
    loaded = {"structure": structure, "end_mass": 0.07, "gravity": -9.81}
    rig = with_mechanics(ROTARY, motor_damping=0.0, link_damping=0.0, **loaded, **FRICTIONLESS)
    plant = DiscretePlant.build(rig, 1e-3)
    weight = -0.07 * 9.81 * 0.1
    inertia = 1.9e-4 + 1.58e-3 + 0.07 * 0.1**2
    centre = np.array([1.9e-4, inertia - 1.9e-4]) / inertia
    falling = run(plant, 30, state=plant.at_rest(0.0))[-1]
    velocities = falling[[MOTOR_VELOCITY, plant.handle_position + 1]]
    assert centre @ velocities == pytest.approx(weight * 0.030 / inertia, rel=1e-9)

    held = run(plant, 30, state=plant.at_rest(0.0), external=-weight)
    assert held[-1, :2] == pytest.approx([0.0, 0.0], abs=1e-15)


# Coulomb friction ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lag_s", [0.0, 1e-4])
@pytest.mark.parametrize(
    ("rig", "command", "external"),
    [
        (with_mechanics(LINEAR, motor_coulomb=0.1, link_coulomb=0.09), 0.1899, 0.0),
        (with_mechanics(LINEAR, motor_coulomb=0.1, link_coulomb=0.09), 1.0, -1.1899),
        (ROTARY, 0.00499, 0.0),
        (ROTARY, -0.00499, 0.00169),
    ],
    ids=["rigid", "rigid balanced", "two-mass", "two-mass both"],
)
def test_friction_holds_a_smaller_push(rig: RigModel, command: float, external: float, lag_s: float) -> None:
    plant = DiscretePlant.build(with_amplifier(rig, lag_s=lag_s), TICK_S)
    start = plant.at_rest(0.1234)
    start[plant.effort] = command  # the effort is there already: a rising one might slip past its balance
    still = [i for i in range(plant.edge_age) if i != plant.effort]
    rows = run(plant, 2000, state=start.copy(), command=command, external=external)
    assert (rows[:, still] == start[still]).all()
    assert (rows[:, plant.edge_age] == math.inf).all()  # and no encoder edge came


def test_only_the_link_moves_when_the_push_overcomes_its_friction_but_not_the_motors() -> None:
    plant = DiscretePlant.build(ROTARY, TICK_S)
    push = 0.004  # above 0.0017 of the link; the remainder is below 0.005 of the motor
    rows = run(plant, 4000, state=plant.at_rest(0.0), external=push)
    assert (rows[:, MOTOR] == 0.0).all()
    at_rest = rows[-1]
    assert at_rest[LINK_VELOCITY] == 0.0
    # It rests anywhere in the band where friction can carry the difference.
    assert (push - 0.0017) <= 2310.0 * at_rest[LINK] <= (push + 0.0017)


@example(free=(0.5, 1.0), gains=(2.0, 0.5, 1.0), levels=(5e-324, 0.0))
@given(
    free=st.tuples(*[st.floats(-10.0, 10.0, allow_subnormal=False)] * 2),
    gains=st.tuples(
        st.floats(0.01, 10.0), st.floats(-0.99, 0.99, allow_subnormal=False), st.floats(0.01, 10.0)
    ),
    levels=st.tuples(*[st.floats(0.0, 10.0, allow_subnormal=False)] * 2),
)
def test_the_friction_pair_obeys_coulombs_law_on_both_masses(
    free: tuple[float, float], gains: tuple[float, float, float], levels: tuple[float, float]
) -> None:
    motor, correlation, link = gains
    cross = correlation * math.sqrt(motor * link)
    *friction, motor_velocity, link_velocity = rub_both(*free, motor, cross, link, *levels)
    velocity = np.array([motor_velocity, link_velocity])
    matrix = np.array([[motor, cross], [cross, link]])
    assert velocity == pytest.approx(np.array(free) + matrix @ friction, abs=1e-10)
    for f, v, level in zip(friction, velocity, levels, strict=True):
        assert abs(f) <= level
        if abs(v) > 1e-10:  # sliding: full friction against the motion, unless it is too small to change it
            assert f == pytest.approx(-math.copysign(level, v), rel=0.0, abs=1e-15)


def test_stick_slip_under_a_slow_push_is_that_of_the_closed_form() -> None:
    """A sinusoidal push slides a mass once in each half period and leaves it stuck in between."""
    mass, coulomb, amplitude, frequency_hz = 0.52, 0.19, 0.25, 5.0
    omega, half = 2 * math.pi * frequency_hz, 0.5 / frequency_hz
    begins = math.asin(coulomb / amplitude) / omega

    def velocity(t: Any) -> Any:
        pushed = amplitude / omega * (math.cos(omega * begins) - np.cos(omega * t))
        return (pushed - coulomb * (t - begins)) / mass

    def position(t: Any) -> Any:
        swung = (np.sin(omega * t) - math.sin(omega * begins)) / omega
        pushed = amplitude / omega * (math.cos(omega * begins) * (t - begins) - swung)
        return (pushed - 0.5 * coulomb * (t - begins) ** 2) / mass

    rests = brentq(velocity, 0.5 * half, begins + half)
    distance = position(rests)
    plant = DiscretePlant.build(with_mechanics(LINEAR, motor_coulomb=coulomb), TICK_S)
    state, times = plant.at_rest(0.0), TICK_S * np.arange(1, round(4 * half / TICK_S) + 1)
    pushes = amplitude * np.sin(omega * (times - 0.5 * TICK_S))
    rows = np.array([run(plant, 1, state=state, command=push)[0] for push in pushes])
    sliding = (times > begins) & (times < rests)
    assert rows[sliding, 0] == pytest.approx(position(times[sliding]), abs=1e-8)
    for n, resting_place in enumerate([distance, 0.0, distance]):
        stuck = (times > rests + n * half + TICK_S) & (times < begins + (n + 1) * half - TICK_S)
        assert stuck.sum() > 400
        assert rows[stuck, 0] == pytest.approx(resting_place, abs=1e-8)
        assert not np.diff(rows[stuck, 0]).any()


# Encoder ---------------------------------------------------------------------------------------------------------


@given(
    velocity=st.floats(1e-3, 0.2), direction=st.sampled_from([-1, 1]), offset=st.sampled_from([0.0, 0.3, 0.5])
)
@settings(max_examples=12)
def test_at_constant_speed_edges_are_dated_exactly(velocity: float, direction: int, offset: float) -> None:
    """Speeds range from less than one edge in five ticks to ten edges per tick, in both directions."""
    rig = replace(LINEAR, encoder=Encoder(quantum=1e-6, offset=offset))
    plant = DiscretePlant.build(rig, TICK_S)
    state = plant.at_rest(0.2e-6)
    state[1] = direction * velocity
    for k in range(1, 200):
        advance(plant.arguments(state), 0.0, 0.0)
        position = 0.2 + offset + direction * velocity * k * TICK_S / 1e-6  # in counts from an edge
        if abs(position - round(position)) < 1e-6:
            continue  # on an edge: rounding decides whether it has passed
        edge = math.floor(position) if direction > 0 else math.ceil(position)
        if edge == (math.ceil(0.2 + offset) - (direction > 0)):
            assert state[plant.edge_age] == math.inf
        else:
            assert state[plant.edge_age] == pytest.approx(abs(position - edge) * 1e-6 / velocity, abs=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_count_of_a_tick_is_the_count_of_the_state_it_leaves(sign: Literal[1, -1]) -> None:
    rig = replace(ROTARY, encoder=Encoder(counts_per_revolution=1000, ratio=10.0, offset=0.3, sign=sign))
    plant = DiscretePlant.build(rig, TICK_S)
    state, counts = plant.at_rest(0.0), []
    for _ in range(500):
        counts.append(advance(plant.arguments(state), 0.1, 0.0))
        assert counts[-1] == plant.count(state)
    assert sign * counts[-1] > 50
    assert counts == sorted(counts, reverse=sign < 0)


# Building --------------------------------------------------------------------------------------------------------


def test_a_step_longer_than_half_a_period_of_the_capstan_mode_is_refused_with_the_bound() -> None:
    slow = with_simulation(ROTARY, inner_step_s=1e-3)
    with pytest.raises(ConfigError, match="too long") as caught:
        DiscretePlant.build(slow, 1e-3)
    assert "0.00085" in caught.value.remedy  # 1 / (2 · 586 Hz)
    DiscretePlant.build(with_simulation(LINEAR, inner_step_s=1e-3), 1e-3)  # a rigid rig has no such mode


@pytest.mark.parametrize("tick_s", [0.0, -1e-3, math.inf, math.nan])
def test_a_tick_that_is_no_time_is_refused(tick_s: float) -> None:
    with pytest.raises(ConfigError, match="tick"):
        DiscretePlant.build(ROTARY, tick_s)


# In C ------------------------------------------------------------------------------------------------------------


class PlantInC(ctypes.Structure):
    """The C structure `struct plant` of plant.h."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("order", "delay_ticks")),
        *((name, ctypes.c_void_p) for name in ("phi", "gamma", "parameters", "state")),
    ]


def test_the_plant_in_c_moves_alike_to_the_last_bit(tmp_path: Path) -> None:
    """Runs that stick, slip, turn and saturate, on both structures, free and held."""
    need_compiler()
    source = Path(plants.__file__).with_name("plant.c")
    flags = ("-O2", "-ffp-contract=off", "-shared", "-fPIC")
    subprocess.run([*FIRMWARE.compiler(), *flags, source, "-o", tmp_path / "plant.so"], check=True)
    advance_in_c = ctypes.CDLL(str(tmp_path / "plant.so")).plant_advance
    advance_in_c.restype = ctypes.c_int64
    free = (with_mechanics(LINEAR, motor_coulomb=0.19), ROTARY)
    for rig in (*free, *(rig.held_by(GRIPS["normal"], None) for rig in free)):
        plant = DiscretePlant.build(with_simulation(rig, computation_delay_ticks=2), 2e-4)
        state, other = plant.at_rest(0.01), plant.at_rest(0.01)
        addresses = (array.ctypes.data for array in (*plant.arrays, other))
        in_c = PlantInC(len(plant.phi), plant.delay_ticks, *addresses)
        for k in range(400):
            push = 1.2 * rig.amplifier.effort_limit * math.sin(0.3 * k) ** 3, 0.01 * math.cos(0.2 * k)
            count = advance_in_c(ctypes.byref(in_c), *map(ctypes.c_double, push))
            assert advance(plant.arguments(state), *push) == count
        assert state.tobytes() == other.tobytes()
