"""A hand driven from outside: it follows requested positions, stays in reach, and rests without requests."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from rig import config
from rig.config import presets
from rig.core.errors import ConfigError
from rig.core.operators import GRIPS
from rig.realtime.hand import Wish
from sim_backend.board.hardware import Hardware
from sim_backend.mechanics.driven_hand import (
    AHEAD_M,
    AHEAD_N,
    BACK_M,
    BLOCK_S,
    FOLLOW_HZ,
    PRESS_N,
    REACH_M_S,
    SILENT_S,
    DrivenHand,
    follow,
)

AHEAD = min(AHEAD_M, AHEAD_N / GRIPS["normal"].hand_stiffness)
RATE = 1000
EXPERIMENT = config.override(
    presets.load("koul-compliant"),
    {
        "trial.kind": "human",
        "operator.press": 4.0,
        "rig.limits.human": False,
        "operator.tremor": 0.0,
        "operator.press_modulation": 0.0,
        "trial.baseline_s": 0.5,
    },
)
MODEL = config.rig_model(EXPERIMENT)
START, RADIUS, PACE = MODEL.reach.start, MODEL.mechanics.handle_radius, MODEL.reach.pace
LEAD_S = MODEL.reach.wait_s - MODEL.reach.free_s  # from the arrival at the start until the wishes count


class Wishes:
    """The requested position and press of a hand."""

    def __init__(self) -> None:
        self.wish = Wish(0, 0.0, 0.0)

    def set(self, position: Any, press: float = 0.0) -> None:
        self.wish = Wish(self.wish.sequence + 1, position, press)

    def __call__(self) -> Any:
        return self.wish


def play_hand(driven: Any, seconds: Any, hand: Any = START, wish: Any = None) -> Any:
    """Return the hand's intended motion for some seconds; `wish` is called before each block."""
    rows = []
    while sum(map(len, rows)) < seconds * RATE:
        if wish is not None:
            wish()
        rows.append(driven.next(hand).rows)
    return np.concatenate(rows)


def begun(model: Any = MODEL, position: Any = START) -> Any:
    wishes = Wishes()
    driven = DrivenHand(model, wishes)
    driven.begin(position, 1.0 / RATE)
    driven.next(position)
    return driven, wishes


def test_while_it_homes_it_goes_along_whatever_is_wished() -> None:
    wishes = Wishes()
    driven = DrivenHand(MODEL, wishes)
    driven.begin(START - 0.02, 1.0 / RATE)
    wishes.set(0.3, 5.0)
    rows = driven.next(0.0).rows
    along = round(0.02 / PACE * RATE)
    assert len(rows) == pytest.approx(along + LEAD_S * RATE, abs=2), "the baseline is the leader's"
    assert np.all(np.diff(rows[:along, 0]) > 0.0)
    assert np.allclose(rows[along:], [START, 0.0, 0.0], atol=1e-12)


@given(distance=st.floats(-1.0, 1.0, allow_subnormal=False), rate=st.floats(-5.0, 5.0, allow_subnormal=False))
def test_it_follows_as_the_differential_equation_does(distance: float, rate: float) -> None:
    omega = 2.0 * math.pi * FOLLOW_HZ  # critically damped
    wanted = expm(0.02 * np.array([[0.0, 1.0], [-(omega**2), -2.0 * omega]])) @ [distance, rate]
    left, speed = follow(distance, rate, np.array([0.02]))
    assert [left[0], speed[0]] == pytest.approx(wanted, abs=1e-9)


def test_a_step_of_a_key_becomes_a_motion_without_overshoot() -> None:
    driven, wishes = begun()
    goal = START + 0.1  # 10 mm at the handle
    rows = play_hand(driven, 0.8, wish=lambda: wishes.set(goal, 3.0))
    assert np.all(np.diff(rows[:, 0]) >= 0.0)
    assert rows[-1, 0] == pytest.approx(goal, abs=1e-4)
    assert np.abs(rows[:, 1]).max() * RADIUS < 0.08
    assert np.abs(np.diff(rows[:, 1])).max() * RATE * RADIUS < 6.0, "m/s²: no jerk of the arm"
    assert np.allclose(np.diff(rows[:, 0]) * RATE, rows[1:, 1], atol=0.02), "the rate is that of the position"
    assert rows[-1, 2] == pytest.approx(3.0 * RADIUS, rel=1e-3)
    assert rows[:, 2].max() <= 3.0 * RADIUS


@pytest.mark.parametrize("far", [0.05, 0.2, 1e6])
def test_a_jump_to_the_other_end_is_a_reach_at_a_bounded_speed(far: float) -> None:
    """The end key or a mouse can jump; once, the speed grew with the distance, to 0.26 m/s."""
    driven, wishes = begun()
    rows = play_hand(driven, 3.0, wish=lambda: wishes.set(START + far))
    speed = rows[:, 1] * RADIUS
    assert speed.max() <= REACH_M_S * (1.0 + 1e-9)
    assert speed.min() >= -1e-9, "without overshoot"
    if far > 1.0:
        assert speed.max() == pytest.approx(REACH_M_S, rel=0.01)
    goal = min(START + far, MODEL.reach.target + AHEAD / RADIUS)
    assert rows[-1, 0] == pytest.approx(goal, abs=1e-4)


@settings(max_examples=10)
@given(
    drawn=st.lists(
        st.tuples(
            st.floats(-1e6, 1e6, allow_subnormal=False),
            st.floats(-1e6, 1e6, allow_subnormal=False),
            st.integers(1, 100),
        ),
        min_size=1,
        max_size=10,
    ),
    mirrored=st.booleans(),
)
def test_it_stays_in_reach_whatever_is_wished(drawn: Any, mirrored: bool) -> None:
    model = MODEL
    if mirrored:
        model = replace(MODEL, reach=replace(MODEL.reach, start=-START, target=-MODEL.reach.target))
    side = -1.0 if mirrored else 1.0
    driven, wishes = begun(model, side * START)
    ahead = min(AHEAD_M, AHEAD_N / MODEL.operator.hand_stiffness) / RADIUS
    for position, press, blocks in drawn:
        for _ in range(blocks):
            wishes.set(position, press)
            rows = driven.next(side * START).rows * side
            assert np.all(rows[:, 0] >= START - BACK_M / RADIUS - 1e-9)
            assert np.all(rows[:, 0] <= side * model.reach.target + ahead + 1e-9)
            assert np.all(rows[:, 2] >= -1e-12)
            assert np.all(rows[:, 2] <= PRESS_N * RADIUS + 1e-9)


def test_hand_without_wishes_rests_where_it_is() -> None:
    driven, wishes = begun()
    play_hand(driven, 0.5, wish=lambda: wishes.set(0.05, 4.0))
    rows = play_hand(driven, SILENT_S - 2 * BLOCK_S, hand=0.011)  # the last word counts for a while
    assert rows[-1, 2] == pytest.approx(4.0 * RADIUS, rel=1e-2)
    rows = play_hand(driven, 1.0, hand=0.011)
    assert rows[-1, 0] == pytest.approx(0.011, abs=1e-5)
    assert rows[-1, 2] == pytest.approx(0.0, abs=1e-5)
    rows = play_hand(driven, 1.0, hand=0.02)
    assert rows[-1, 0] == pytest.approx(0.011, abs=1e-5), "it does not run away with the handle"
    rows = play_hand(driven, 1.0, wish=lambda: wishes.set(0.03))
    assert rows[-1, 0] == pytest.approx(0.03, abs=1e-4), "and follows the next wish"


def test_wish_before_the_session_moves_nothing() -> None:
    wishes = Wishes()
    wishes.set(0.2, 9.0)
    driven = DrivenHand(MODEL, wishes)
    driven.begin(START, 1.0 / RATE)
    rows = play_hand(driven, LEAD_S + 1.5)
    assert np.allclose(rows, [START, 0.0, 0.0], atol=1e-12)


def test_tremor_comes_with_the_effort_of_the_hand() -> None:
    model = replace(MODEL, operator=replace(MODEL.operator, tremor=166e-6))
    driven, wishes = begun(model)
    loose = play_hand(driven, 1.0, wish=lambda: wishes.set(START))
    assert np.ptp(loose[:, 0]) == 0.0
    driven, wishes = begun(model)
    play_hand(driven, 1.0, wish=lambda: wishes.set(START, 4.0))
    pressing = play_hand(driven, 2.0, wish=lambda: wishes.set(START, 4.0))
    share = 4.0 / (4.0 + MODEL.operator.hand_stiffness * MODEL.operator.depth)
    assert np.std(pressing[:, 0]) * RADIUS == pytest.approx(166e-6 * share, rel=0.05)


def test_rig_without_a_hand_cannot_be_driven_by_wishes() -> None:
    with pytest.raises(ConfigError, match="no person holds the handle"):
        DrivenHand(config.rig_model(presets.load("koul-compliant")), Wishes())


def test_hardware_plays_it_and_the_handle_goes_along() -> None:
    hardware = Hardware(MODEL, RATE, seed=0, initial_position=START)
    wishes = Wishes()
    hardware.drive_hand(DrivenHand(MODEL, wishes))
    hardware.advance(0)
    hardware.begin_session()
    for _ in range(round(LEAD_S * RATE) + 2):
        hardware.advance(0)
    before = hardware.count
    for _ in range(round(0.8 * RATE)):
        wishes.set(START + 0.05)
        hardware.advance(0)
    moved = (hardware.count - before) * MODEL.encoder.resolution
    assert moved == pytest.approx(0.05, abs=0.003), "friction holds some of it"
