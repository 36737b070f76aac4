"""Reference motions: consistent derivatives, and encoder edges at the right times."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.estimators import quantise
from rig.experiments.estimation._signals import SIGNALS, Signal, edge_times, sine, wall_bounce
from tests.conformance.tiers import first_by_default

FINE = 1e-6  # step of the brute-force oracles (s)


@pytest.mark.parametrize("name", SIGNALS)
def test_velocity_and_acceleration_are_the_derivatives_of_the_position(name: Any) -> None:
    signal = SIGNALS[name]
    t = np.linspace(0.0, signal.end_s, 200_001)
    motion = signal(t)
    step = t[1]
    velocity, acceleration = np.gradient(motion.position, step), np.gradient(motion.velocity, step)
    smooth = np.ones(len(t), dtype=bool)
    smooth[[0, 1, -2, -1]] = False
    if name == "wall-bounce":
        smooth[np.abs(t - 0.1) < 2 * step] = False  # the acceleration jumps at contact
    for found, exact, tolerance in (
        (velocity, motion.velocity, 1e-5),
        (acceleration, motion.acceleration, 1e-4),
    ):
        assert np.abs(found - exact)[smooth].max() <= tolerance * np.abs(exact).max() + 1e-9


def test_the_bounce_is_a_mass_on_a_spring_that_met_the_wall_with_the_approach_speed() -> None:
    bounce = wall_bounce(approach=0.2, contact_s=0.05, ring_hz=30.0, damping_ratio=0.1)
    at_contact = bounce([0.05 - 1e-12, 0.05, 0.05 + 1e-12])
    assert at_contact.position == pytest.approx(0.0, abs=1e-12)
    assert at_contact.velocity == pytest.approx(0.2)
    t = np.linspace(0.06, 0.3, 1000)
    x, v, a = bounce(t)
    natural = 2 * np.pi * 30.0 / np.sqrt(1 - 0.1**2)
    assert a + 2 * 0.1 * natural * v + natural**2 * x == pytest.approx(0.0, abs=1e-9 * natural)


def brute_force_edges(signal: Signal, times: np.ndarray, resolution: float, offset: float) -> np.ndarray:
    t = np.arange(round(times[-1] / FINE) + 1) * FINE
    cell = np.floor(signal(t).position / resolution + offset)
    changed = np.where(np.diff(cell, prepend=cell[0]) != 0, t, -np.inf)
    return np.maximum.accumulate(changed)[np.round(times / FINE).astype(int)]


@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("offset", first_by_default([0.5, 0.13]))
def test_edges_are_where_a_finely_sampled_encoder_changes(name: Any, offset: float) -> None:
    signal, resolution = SIGNALS[name], 2e-5
    times = np.arange(0.0, min(signal.end_s, 0.5), 1e-3)
    found, expected = (
        edge_times(signal, times, resolution, offset=offset),
        brute_force_edges(signal, times, resolution, offset),
    )
    known = np.isfinite(expected)
    assert (np.isfinite(found) == known).all()
    assert found[known] == pytest.approx(expected[known], abs=1.01 * FINE)


def test_a_turn_between_two_samples_may_leave_an_edge_that_no_count_shows() -> None:
    """The motion crosses a boundary to and fro within a period: the count is unchanged, the last edge is not."""
    signal = sine(amplitude=1e-3, frequency_hz=10.0)  # its peak, at 25 ms, is 1 mm
    times, resolution, offset = np.array([0.0, 0.023, 0.027]), 1e-3, 1e-4  # a boundary 0.1 µm below the peak
    assert quantise(signal(times).position, resolution, offset=offset).tolist() == [0, 0, 0]
    edges = edge_times(signal, times, resolution, offset=offset)
    assert edges[:2].tolist() == [-np.inf, -np.inf]
    assert edges[2] == pytest.approx(0.025 + np.arccos(0.9999) / (20 * np.pi), abs=1e-9)


@given(
    speed=st.floats(0.01, 1.0),
    resolution=st.floats(1e-6, 1e-4),
    offset=st.floats(0.0, 0.99, allow_subnormal=False),
    sign=st.sampled_from([-1, 1]),
)
def test_an_edge_lies_between_its_sample_and_the_one_before_that_shows_another_count(
    speed: float, resolution: float, offset: float, sign: Any
) -> None:
    signal, times = sine(amplitude=sign * speed / 30.0, frequency_hz=5.0), np.arange(60) * 1e-3
    edges = edge_times(signal, times, resolution, offset=offset)
    counts = quantise(signal(times).position, resolution, offset=offset)
    changed = np.flatnonzero(np.diff(counts)) + 1
    assert (edges <= times).all()
    assert (np.diff(edges[np.isfinite(edges)]) >= 0).all()
    assert (edges[changed] >= times[changed - 1] - 1e-12).all()
