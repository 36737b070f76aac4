"""The guard: the last word before an effort leaves."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control._guard import clip_effort, current_quanta, limit_slew

EFFORT = st.floats(-1e6, 1e6)
POSITIVE = st.floats(1e-6, 1e3)


@given(effort=EFFORT, limit=POSITIVE)
def test_an_effort_is_clipped_to_its_limit_and_otherwise_untouched(effort: Any, limit: Any) -> None:
    result = clip_effort(effort, limit)
    assert abs(result) <= limit
    if abs(effort) <= limit:
        assert result == effort
    else:
        assert result == math.copysign(limit, effort)


@pytest.mark.parametrize("effort", [math.nan, math.inf, -math.inf])
def test_an_effort_that_is_not_finite_becomes_zero_not_the_limit(effort: Any) -> None:
    assert clip_effort(effort, 1.0) == 0.0


@given(effort=EFFORT, previous=EFFORT, step=POSITIVE)
def test_slew_limit_stops_between_previous_and_wanted_effort(effort: Any, previous: Any, step: Any) -> None:
    result = limit_slew(effort, previous, step)
    assert min(effort, previous) <= result <= max(effort, previous)
    if abs(effort - previous) <= step * (1 - 1e-9):
        assert result == effort
    else:
        assert abs(result - previous) == pytest.approx(step, rel=1e-9, abs=1e-9)


def test_an_infinite_step_never_binds() -> None:
    assert limit_slew(1.3, -1.3, math.inf) == 1.3


@given(effort=st.floats(-10.0, 10.0), quantum=st.floats(1e-3, 1.0))
def test_rounding_moves_an_effort_by_half_a_quantum_at_most(effort: float, quantum: float) -> None:
    quanta = current_quanta(effort, quantum)
    assert quanta.is_integer()
    assert abs(quanta * quantum - effort) <= 0.5 * quantum * (1 + 1e-9)


@given(quanta=st.integers(-32767, 32767), quantum=st.floats(1e-6, 1.0))
def test_whole_quanta_are_sent_as_they_are(quanta: int, quantum: float) -> None:
    assert current_quanta(quanta * quantum, quantum) == quanta


def test_halves_round_towards_positive_infinity_in_every_language() -> None:
    """The firmware's law must give the same integer, so the tie rule is part of the contract."""
    assert [current_quanta(x, 1.0) for x in (-1.5, -0.5, 0.5, 1.5)] == [-1, 0, 1, 2]


@pytest.mark.parametrize(("effort", "expected"), [(1e9, 32767), (-1e9, -32767), (32767.4, 32767)])
def test_a_current_saturates_within_16_bits_on_both_sides(effort: float, expected: int) -> None:
    assert current_quanta(effort, 1.0) == expected
