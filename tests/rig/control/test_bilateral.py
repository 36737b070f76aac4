"""Laws for impedance measurements: a wall on both sides, and one with an excitation timed by elapsed ticks."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control import bilateral, laws
from rig.control.excitation import ramp

WALL = {"stiffness": 1000.0, "damping": 5.0, "side": 1, "pull": "clamp", "damping_on": "both"}
TABLE = np.array([1.0, -2.0, 3.0, 0.5])


def excited(wall: Any = WALL, table: Any = TABLE, ramp_ticks: int = 0) -> Any:
    """Return the law with its memory as a function of penetration, velocity and elapsed ticks."""
    prepared = bilateral.excited_law(table, ramp_ticks).prepare(wall)

    def react(penetration: float = 0.0, velocity: float = 0.0, elapsed: int = 1) -> Any:
        return prepared.law.function(penetration, velocity, elapsed, prepared.state, prepared.parameters)

    return react


@given(st.floats(-1.0, 1.0, allow_subnormal=False), st.floats(-10.0, 10.0, allow_subnormal=False))
def test_a_bilateral_wall_pulls_as_it_pushes(penetration: float, velocity: float) -> None:
    law = laws.get("bilateral").prepare(WALL)
    reaction = law.law.function(penetration, velocity, 1, law.state, law.parameters)
    assert reaction == pytest.approx(1000.0 * penetration + 5.0 * velocity, abs=1e-9)
    mirrored = law.law.function(-penetration, -velocity, 1, law.state, law.parameters)
    assert mirrored == -reaction
    assert law.state[0] == 0.0, "never clamped"


def test_the_excitation_is_taken_off_the_reaction_and_goes_round() -> None:
    react = excited()
    assert [react() for _ in range(6)] == [-1.0, 2.0, -3.0, -0.5, -1.0, 2.0]
    react = excited()
    assert react(0.01, 0.2) == pytest.approx(1000.0 * 0.01 + 5.0 * 0.2 - 1.0)


def test_excitation_acts_along_the_position_on_either_side() -> None:
    """Effort along the position is −side · reaction."""
    for side in (1, -1):
        react = excited(WALL | {"side": side})
        assert [-side * react() for _ in range(3)] == [1.0, -2.0, 3.0]


@given(st.lists(st.integers(1, 9), min_size=1, max_size=30), st.integers(0, 12))
def test_lost_samples_are_skipped_in_the_excitation(elapsed: list[int], ramp_ticks: int) -> None:
    """The excitation depends on the tick number only, not on how many samples arrived; the first call is tick 0."""
    react = excited(ramp_ticks=ramp_ticks)
    ticks = np.concatenate([[0], np.cumsum(elapsed[1:])]).astype(int)
    whole = bilateral.played(
        bilateral.excited_law(TABLE, ramp_ticks).prepare(WALL).parameters, 1, 1e-3, int(ticks[-1]) + 1
    )
    assert [-react(elapsed=n) for n in elapsed] == pytest.approx(whole[ticks].tolist(), abs=1e-12)


def test_excitation_rises_without_a_step() -> None:
    table, ticks = np.ones(5), 100
    react = excited(table=table, ramp_ticks=ticks)
    rising = np.array([-react() for _ in range(ticks + 20)])
    assert rising == pytest.approx(ramp(np.arange(ticks + 20), ticks), abs=1e-12)
    assert rising[0] == 0.0
    assert (rising[ticks:] == 1.0).all()
    assert np.abs(np.diff(rising)).max() < 2.0 / ticks


def test_the_laws_are_found_by_name_so_that_a_recording_can_be_replayed() -> None:
    for name in ("bilateral", "excited"):
        assert name in laws.names()
        assert laws.get(name).prepare(WALL).parameters[:2].tolist() == [1000.0, 5.0]
