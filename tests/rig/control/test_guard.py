"""The guard: the last limits of effort and slew before a current is sent."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control._guard import clip_effort, current_quanta, limit_slew

EFFORT = st.floats(-1e6, 1e6, allow_subnormal=False)  # N·m or N
LIMIT = st.floats(1e-6, 1e3)  # N·m or N: of an effort, or of its change in a tick
ROUNDING = 1e-9  # relative: more than the errors of a few operations on floats
PEAK = 32767  # quanta: largest current on the wire, 16 bits, the same on both sides of zero


@given(effort=EFFORT, limit=LIMIT)
def test_an_effort_is_clipped_to_its_limit_and_otherwise_untouched(effort: float, limit: float) -> None:
    result = clip_effort(effort, limit)
    assert abs(result) <= limit
    if abs(effort) <= limit:
        assert result == effort
    else:
        assert result == math.copysign(limit, effort)


@pytest.mark.parametrize("effort", [math.nan, math.inf, -math.inf])
def test_an_effort_that_is_not_finite_becomes_zero_not_the_limit(effort: float) -> None:
    assert clip_effort(effort, 1.0) == 0.0


@given(effort=EFFORT, previous=EFFORT, step=LIMIT)
def test_slew_limit_ends_between_previous_and_new_effort(effort: float, previous: float, step: float) -> None:
    result = limit_slew(effort, previous, step)
    assert min(effort, previous) <= result <= max(effort, previous)
    # Within rounding of the step, `previous + step` may be just below the effort: the second branch accepts both.
    if abs(effort - previous) <= step * (1 - ROUNDING):
        assert result == effort
    else:
        assert abs(result - previous) == pytest.approx(step, rel=ROUNDING, abs=1e-9)


def test_an_infinite_step_does_not_limit_the_effort() -> None:
    assert limit_slew(1.3, -1.3, math.inf) == 1.3


@given(effort=st.floats(-10.0, 10.0, allow_subnormal=False), quantum=st.floats(1e-3, 1.0))
def test_rounding_moves_an_effort_by_half_a_quantum_at_most(effort: float, quantum: float) -> None:
    quanta = current_quanta(effort, quantum)
    assert quanta.is_integer()
    assert abs(quanta * quantum - effort) <= 0.5 * quantum * (1 + ROUNDING)


@given(quanta=st.integers(-PEAK, PEAK), quantum=st.floats(1e-6, 1.0))
def test_whole_quanta_are_sent_as_they_are(quanta: int, quantum: float) -> None:
    assert current_quanta(quanta * quantum, quantum) == quanta


def test_halves_round_towards_positive_infinity_on_host_and_firmware() -> None:
    """The firmware must compute the same integers, so this rounding rule is part of the interface."""
    assert [current_quanta(effort, 1.0) for effort in (-1.5, -0.5, 0.5, 1.5)] == [-1, 0, 1, 2]


@pytest.mark.parametrize(("effort", "expected"), [(1e9, PEAK), (-1e9, -PEAK), (PEAK + 0.4, PEAK)])
def test_a_current_saturates_within_16_bits_on_both_sides(effort: float, expected: int) -> None:
    assert current_quanta(effort, 1.0) == expected
