"""A simulated person: the scripted intentions of the hand, the plant in that hand, and whole trials."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.core.model import Mechanics, Operator, OperatorReach, RigModel
from rig.core.operators import GRIPS
from sim_backend.board.hardware import Hardware
from sim_backend.mechanics.operator import PRESS_HZ, REPEAT_S, TREMOR_HZ, OperatorScript
from sim_backend.mechanics.plant import DiscretePlant, advance, energy
from tests.conformance.rigs import rotary_rig
from tests.conformance.tiers import first_by_default
from tests.sim_backend.test_plant import CAPSTAN, LINEAR, ROTARY, run, with_mechanics

TICK_S = 5e-4
REACH = OperatorReach(start=-0.05, target=0.02, pace=0.5, wait_s=0.1, seed=3)
TWO_MASS = ROTARY.mechanics
RIGID = replace(TWO_MASS, structure="rigid")
STILL = replace(GRIPS["normal"], tremor=0.0, press_modulation=0.0)


def held(operator: Operator = STILL, reach: OperatorReach | None = REACH, **mechanics: Any) -> RigModel:
    rig = replace(rotary_rig(), mechanics=replace(RIGID, **mechanics))
    return rig.held_by(operator, reach)


def script(
    operator: Operator = STILL, position: float = 0.0, session: int = 0, **reach: Any
) -> OperatorScript:
    return OperatorScript.of(held(operator, replace(REACH, **reach)), TICK_S, position, session)


# The script


def test_the_hand_goes_along_to_the_start_waits_and_reaches_on_a_raised_cosine() -> None:
    rows = script().rows
    t = (np.arange(len(rows)) + 0.5) * TICK_S
    arrives, begins, ends = 0.1, 0.2, 0.2 + STILL.reach_s  # 0.05 rad at 0.5 rad/s, then 0.1 s
    wanted = rows[:, 0]
    assert wanted[t < arrives] == pytest.approx(-0.5 * t[t < arrives])
    waiting = (t > arrives) & (t < begins)
    assert (wanted[waiting] == -0.05).all()
    reaching = (t > begins) & (t < ends)
    cosine = 0.5 - 0.5 * np.cos(math.pi * (t[reaching] - begins) / STILL.reach_s)
    assert wanted[reaching] == pytest.approx(-0.05 + 0.07 * cosine)
    assert wanted[t > ends] == pytest.approx(0.02)
    assert not rows[t < begins, 2].any(), "no press before the reach"
    assert rows[reaching, 2] == pytest.approx(4.0 * 0.1 * cosine)  # N at a radius of 0.1 m
    assert rows[t > ends, 2] == pytest.approx(0.4)


@pytest.mark.parametrize("grip", sorted(GRIPS))
def test_the_intended_velocity_is_the_derivative_of_the_intended_position(grip: str) -> None:
    rows = script(GRIPS[grip]).rows
    slope = (rows[2:, 0] - rows[:-2, 0]) / (2 * TICK_S)
    corner = round(0.1 / TICK_S)  # where the way to the start ends, and where the reach begins: no derivative
    smooth = np.ones(len(slope), bool)
    smooth[corner - 3 : corner + 2] = False
    assert slope[smooth] == pytest.approx(rows[1:-1, 1][smooth], abs=2e-3 * np.abs(slope).max())


@pytest.mark.parametrize("side", [1, -1])
def test_the_hand_presses_the_way_it_reaches(side: int) -> None:
    rows = script(start=-0.05 * side, target=0.02 * side).rows
    assert (side * rows[:, 2] >= 0.0).all()
    assert side * rows[-1, 2] == pytest.approx(0.4)


def test_the_press_swells_by_its_share_twice_a_second() -> None:
    played = script(replace(STILL, press_modulation=0.2))
    press = played.rows[played.again :, 2]
    t = (np.arange(played.again, len(played.rows)) + 0.5) * TICK_S - 0.2
    assert press == pytest.approx(0.4 * (1.0 + 0.2 * np.sin(2 * math.pi * PRESS_HZ * t)))


def test_the_tremor_lies_in_its_band_and_has_its_size_at_the_handle() -> None:
    played = script(replace(STILL, tremor=100e-6))
    swing = (played.rows[played.again :, 0] - 0.02) * 0.1  # m at the handle
    assert swing.std() == pytest.approx(100e-6, rel=1e-9)
    power = np.abs(np.fft.rfft(swing)) ** 2
    hertz = np.fft.rfftfreq(len(swing), TICK_S)
    band = (hertz >= 8.0) & (hertz <= 12.0)
    assert power[band].sum() == pytest.approx(power.sum(), rel=1e-9)
    assert np.count_nonzero(power > 1e-6 * power.max()) == len(TREMOR_HZ)


@given(
    rate=st.sampled_from([100, 1000, 3000, 20_000]),
    position=st.floats(-0.3, 0.3, allow_subnormal=False),
    session=st.integers(0, 5),
    seed=st.integers(0, 2**63 - 1),
)
@settings(max_examples=8)
def test_script_repeats_without_a_seam(rate: int, position: float, session: int, seed: int) -> None:
    model = held(GRIPS["firm"], replace(REACH, seed=seed))
    played = OperatorScript.of(model, 1.0 / rate, position, session)
    assert np.isfinite(played.rows).all()
    assert len(played.rows) - played.again == round(REPEAT_S * rate)
    before, seam = np.diff(played.rows[played.again :], axis=0), played.rows[played.again] - played.rows[-1]
    assert (np.abs(seam) <= np.abs(before).max(axis=0) * 1.5 + 1e-12).all()  # not only its largest step


def test_the_same_seed_gives_the_same_bits_and_every_session_trembles_anew() -> None:
    normal = GRIPS["normal"]
    first = script(normal).rows
    assert first.tobytes() == script(normal).rows.tobytes()
    for other in (script(normal, session=1), script(normal, seed=4)):
        assert other.rows.shape == first.shape
        assert other.rows[:, 0].tobytes() != first[:, 0].tobytes()
        assert other.rows[:, 2].tobytes() == first[:, 2].tobytes()


def test_rig_without_a_reach_has_no_script() -> None:
    assert len(OperatorScript.of(rotary_rig(), TICK_S, 0.0).rows) == 0
    assert len(OperatorScript.of(held(reach=None), TICK_S, 0.0).rows) == 0


# The held plant


@pytest.mark.parametrize("mechanics", first_by_default([RIGID, TWO_MASS]), ids=["rigid", "two-mass"])
@pytest.mark.parametrize("lag_s", first_by_default([1e-4, 0.0]))
def test_a_hand_that_does_not_touch_leaves_the_rig_as_it_is(mechanics: Mechanics, lag_s: float) -> None:
    # The kernel of the held plant and those of the free ones are the same mechanics, with friction and edges.
    free = rotary_rig(lag_s=lag_s, computation_delay_ticks=2)
    free = replace(free, mechanics=mechanics)
    away = replace(STILL, pads_mass=0.0, pads_stiffness=0.0, pads_damping=0.0)
    plants = [DiscretePlant.build(rig, 2e-4) for rig in (free, free.held_by(away, None))]
    states = [plant.at_rest(0.01) for plant in plants]
    states[1][plants[1].intentions] = 0.5, 3.0, -1.0
    order = plants[0].edge_age
    stuck = 0
    for k in range(1500):
        push = 0.01 * math.sin(0.008 * k) ** 3
        before = states[0][:order].copy()
        counts = [
            advance(plant.arguments(state), push, 0.003 * math.cos(0.02 * k))
            for plant, state in zip(plants, states, strict=True)
        ]
        assert counts[0] == counts[1]
        assert states[1][:order] == pytest.approx(states[0][:order], rel=1e-9, abs=1e-12)
        ages = [state[plant.edge_age] for plant, state in zip(plants, states, strict=True)]
        assert ages[1] == pytest.approx(ages[0], abs=1e-9) or math.isinf(ages[0])
        stuck += before[0] == states[0][0]
    assert 150 < stuck < 1350, "it must stick at times and slide at others"


def test_delayed_commands_and_intentions_do_not_mix() -> None:
    model = replace(rotary_rig(computation_delay_ticks=3), mechanics=RIGID).held_by(STILL, None)
    plant = DiscretePlant.build(model, TICK_S)
    state = plant.at_rest(0.0)
    state[plant.intentions] = 0.01, 0.2, 0.3
    for k in range(5):
        advance(plant.arguments(state), 0.1 * k, 0.0)
    assert state[plant.commands].tolist() == pytest.approx([0.2, 0.3, 0.4])
    assert state[plant.intentions].tolist() == [0.01, 0.2, 0.3]


@pytest.mark.parametrize("rig", [LINEAR, CAPSTAN], ids=["rigid", "two-mass"])
@given(
    start=st.lists(st.floats(-1.0, 1.0, allow_subnormal=False), min_size=6, max_size=6),
    coulomb=st.sampled_from([0.0, 0.3]),
)
@settings(max_examples=8)
def test_a_rig_in_a_relaxed_hand_creates_no_energy(rig: RigModel, start: list[float], coulomb: float) -> None:
    """Energy may rise only in a step in which a mass stops or turns, by at most the friction times its travel.

    The energy is that of both masses, the pads, the hand and all springs; the intended position is zero.
    """
    radius = rig.mechanics.handle_radius
    levels = (0.7 * coulomb * radius, 0.3 * coulomb * radius)
    rig = with_mechanics(rig, motor_coulomb=levels[0], link_coulomb=levels[1]).held_by(GRIPS["relaxed"], None)
    plant = DiscretePlant.build(rig, 1e-4)
    state = plant.at_rest(0.0)
    assert plant.hand_position is not None
    bodies = [plant.sensed_position, plant.handle_position, plant.hand_position]
    state[bodies] = (
        np.array(start[:3]) * [1e-2, 1e-2 if plant.handle_position == 0 else 1.01e-2, 3e-2] / radius
    )
    state[[b + 1 for b in bodies]] = np.array(start[3:]) * 0.3 / radius
    rubbing = {plant.sensed_position: levels[0], plant.handle_position: levels[1]}
    if len(rubbing) == 1:
        rubbing = {0: sum(levels)}
    first = left = energy(state, rig)
    for _ in range(400):
        before = state.copy()
        advance(plant.arguments(state), 0.0, 0.0)
        allowed = sum(
            level * abs(state[x] - before[x])
            for x, level in rubbing.items()
            if before[x + 1] * state[x + 1] <= 0.0
        )
        now = energy(state, rig)
        assert now <= left + allowed * (1 + 1e-6) + 1e-12 * first
        left = now


@pytest.mark.parametrize("rig", [LINEAR, CAPSTAN], ids=["rigid", "two-mass"])
def test_a_press_below_the_friction_level_moves_the_hand_and_not_the_handle(rig: RigModel) -> None:
    radius = rig.mechanics.handle_radius
    rig = with_mechanics(rig, motor_coulomb=0.5 * radius, link_coulomb=1.2 * radius).held_by(
        GRIPS["normal"], None
    )
    plant = DiscretePlant.build(rig, 1e-4)
    assert plant.hand_position is not None
    start = plant.at_rest(0.1234)
    start[plant.intentions][2] = 1.1 * radius  # N: below what the link's side alone can carry
    rows = run(plant, 5000, state=start.copy())
    still = [
        plant.sensed_position,
        plant.sensed_position + 1,
        plant.handle_position,
        plant.handle_position + 1,
    ]
    assert (rows[:, still] == start[still]).all()
    give = 1.1 / (GRIPS["normal"].pads_stiffness + GRIPS["normal"].hand_stiffness) / radius
    assert rows[-1, plant.hand_position] - 0.1234 == pytest.approx(give, rel=1e-6)


# The session


def hardware(**reach: Any) -> Hardware:
    return Hardware(held(GRIPS["normal"], replace(REACH, **reach)), 1000, seed=0, initial_position=0.0)


def pressed(device: Hardware, ticks: int) -> list[int]:
    counts = []
    for _ in range(ticks):
        device.advance(0)
        counts.append(device.count)
    return counts


def test_a_person_keeps_still_until_the_session_begins() -> None:
    device = hardware()
    assert set(pressed(device, 300)) == {device.count}
    device.begin_session()
    counts = pressed(device, 900)
    resolution = held().encoder.resolution
    assert min(counts) * resolution == pytest.approx(-0.05, abs=0.015)
    assert counts[-1] * resolution > 0.02  # nothing is in the way


def test_the_same_person_does_the_same_and_a_second_session_begins_where_the_handle_is() -> None:
    one, other = hardware(), hardware()
    runs = []
    for device in (one, other):
        device.begin_session()
        first = pressed(device, 900)
        device.begin_session()
        runs.append((first, pressed(device, 1200)))
    assert runs[0] == runs[1]
    first, second = runs[0]
    assert abs(second[0] - first[-1]) <= 3
    assert min(second) * held().encoder.resolution == pytest.approx(-0.05, abs=0.015)


def test_at_another_rate_a_person_stays_as_they_are_until_the_next_session() -> None:
    device = hardware()
    device.begin_session()
    pressed(device, 150)
    device.set_rate(500)
    settled = pressed(device, 1000)[-1]
    assert pressed(device, 100) == [settled] * 100
    device.begin_session()
    assert max(pressed(device, 600)) > settled


@pytest.mark.parametrize(
    ("first", "rate"), [(1_000, 1_000), (1_000, 10_000), (10_000, 1_000), (1_000, 4_000)]
)
def test_a_set_point_is_as_late_at_another_rate(first: int, rate: int) -> None:
    hardware = Hardware(rotary_rig(set_point_delay_s=5e-4), first, seed=0, initial_position=None)
    hardware.set_rate(rate)
    late = 0
    while hardware.measured == 0 and late < 100:
        hardware.advance(100)
        late += 1
    assert late - 1 == max(1, round(5e-4 * rate))
