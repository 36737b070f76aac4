"""The homing servo: the effort source before the wall."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control._sources import approach, servo

PLACE = st.floats(-1.0, 1.0, allow_subnormal=False)


@given(setpoint=PLACE, target=PLACE, step=st.floats(1e-6, 0.5))
def test_set_point_approaches_its_target_by_one_step_at_most(setpoint: Any, target: Any, step: float) -> None:
    moved = approach(setpoint, target, step)
    assert abs(moved - setpoint) <= step * (1 + 1e-9)
    assert min(setpoint, target) <= moved <= max(setpoint, target)
    assert abs(target - moved) == pytest.approx(max(0.0, abs(target - setpoint) - step), abs=1e-12)


def test_a_set_point_arrives_exactly_and_stays() -> None:
    """It must be exact, because the loop ends homing when setpoint and target are equal."""
    setpoint, ticks = -0.05, 0
    while setpoint != 0.1 and ticks < 1000:
        setpoint, ticks = approach(setpoint, 0.1, 0.001), ticks + 1
    assert (setpoint, ticks) in ((0.1, 150), (0.1, 151))
    assert approach(setpoint, 0.1, 0.001) == 0.1


@given(error=PLACE, velocity=st.floats(-10, 10, allow_subnormal=False), limit=st.floats(0.01, 1.0))
def test_homing_effort_is_at_most_its_limit(error: Any, velocity: float, limit: float) -> None:
    effort = servo(error, velocity, 50.0, 0.5, limit)
    assert abs(effort) <= limit
    assert effort == pytest.approx(max(-limit, min(limit, 50.0 * error - 0.5 * velocity)))
