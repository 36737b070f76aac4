"""Encoder and current quantisation: the range of true values behind a number of counts or quanta."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control._guard import current_quanta as command_quanta
from sim_backend.board.lockstep import INDEX_COUNT, INDEX_EDGES, INPUTS, WORDS, Wires, sense
from sim_backend.mechanics.sensors import cell, current_quanta, encoder_count

RESOLUTION = 2.0 * math.pi / 40_000.0

positions = st.floats(-10.0, 10.0, allow_subnormal=False)
offsets = st.floats(0.0, 1.0, exclude_max=True, allow_subnormal=False)


@given(positions, offsets)
def test_a_position_lies_in_the_cell_that_its_count_names(position: float, offset: float) -> None:
    low = (encoder_count(position, RESOLUTION, offset, 1) - offset) * RESOLUTION
    slack = 1e-12
    assert low - slack <= position <= low + RESOLUTION + slack


@given(positions, offsets)
def test_a_reversed_encoder_shows_the_negative_count(position: float, offset: float) -> None:
    forward = encoder_count(position, RESOLUTION, offset, 1)
    assert encoder_count(position, RESOLUTION, offset, -1) == -forward
    assert cell(position, RESOLUTION, offset) == forward


@pytest.mark.parametrize(
    ("position", "offset", "count"),
    [(0.0, 0.0, 0), (0.0, 0.5, 0), (-1e-9, 0.0, -1), (0.999, 0.0, 0), (1.5, 0.5, 2), (-0.51, 0.5, -1)],
)
def test_counts_at_the_edges(position: float, offset: float, count: int) -> None:
    assert encoder_count(position, 1.0, offset, 1) == count


@given(st.floats(-60.0, 60.0, allow_subnormal=False), st.sampled_from([1e-3, 1.0]))
def test_the_sensor_rounds_and_saturates_like_the_command(current_a: float, quantum_a: float) -> None:
    halves = round(2.0 * current_a / quantum_a) / 2.0 * quantum_a
    for current in (current_a, halves):
        assert current_quanta(current, quantum_a) == command_quanta(current, quantum_a)
    assert [current_quanta(current, 1.0) for current in (math.inf, -math.inf, math.nan)] == [32767, -32767, 0]


@given(
    st.lists(st.integers(-60, 60), min_size=2, max_size=8),
    st.integers(-9, 9),
    st.integers(2, 17),
    st.sampled_from([-1, 1]),
)
def test_an_index_is_latched_where_it_begins(counts: list[int], first: int, every: int, way: int) -> None:
    """The oracle moves the handle count by count: entering an index cell, from either side, is one edge."""
    wires = Wires(
        effort_quantum=1.0, ampere_per_effort=1.0, quantum_a=1.0, external_effort=0.0, slip=100, leak=0,
        index_first=first, index_counts=every, switch_count=5, switch_way=way,
    )  # fmt: skip
    words = np.zeros(WORDS, np.int64)
    edges, last, at = 0, 0, 0
    for count in counts:
        while at != count:
            at += 1 if count > at else -1
            if (at - first) % every == 0:
                edges, last = edges + 1, at + 100
        sense(words, count, wires)
        assert (words[INDEX_EDGES], words[INDEX_COUNT]) == (edges, last)
        assert (words[INPUTS] != 0) == (way * (count - 5) >= 0)
