"""Figures 7 and 8 of Koul et al., under the conditions that the paper leaves open."""

import math
from typing import Any

import numpy as np
import pytest

from rig.experiments.hits.compare import simulate
from rig.extras.papers.koul import compare


def test_the_handle_is_at_the_start_at_the_first_sample() -> None:
    """A trial without a byte link begins one tick earlier and coasts to the start."""
    for rate in (20_000, 10_000, 2000):
        experiment = compare.koul_entries(rate)[0].applied(compare.koul_experiment())
        _, plant, trace = simulate(experiment, compare.START, 0.4)
        position, velocity = trace.states[0, plant.sensed_position :][:2]
        assert position == pytest.approx(compare.START.position, abs=1e-8)
        assert velocity == pytest.approx(compare.START.velocity, abs=1e-4)


# --- figure 7 ---------------------------------------------------------------------------------------------


def test_few_bits_of_state_take_the_damping_from_a_uniform_wall_alone(figure_7: Any) -> None:
    """A uniform rate with cut-off fs/20 against 200 Hz at 2 kHz, with 14 bits and rounding to zero."""
    fixed = {panel.position_rate: panel.peaks for panel in figure_7 if panel.arithmetic == compare.FIXED}
    expected = {20_000: (57.0, 57.0, 29.0), 10_000: (57.0, 39.75, 29.0)}
    assert fixed == {rate: pytest.approx(peaks, abs=0.5) for rate, peaks in expected.items()}


@pytest.fixture(scope="module")
def figure_7() -> Any:
    return compare.koul_figure_7()


@pytest.fixture(scope="module")
def figure_8() -> Any:
    return compare.koul_figure_8()


def test_in_floating_point_the_uniform_wall_is_as_well_damped_as_the_dual_rate_one(figure_7: Any) -> None:
    """The effect in figure 7 is due to the word length, not to the method."""
    for panel in figure_7:
        none, uniform, dual = panel.peaks
        assert none == 57.0
        if panel.arithmetic == compare.FLOAT:
            assert 1.0 <= uniform / dual < 1.08
            assert uniform < 0.6 * none
            assert panel.comparison["uniform"].numbers.decay == 0.0
        elif panel.position_rate == 20_000:
            uniform_hits, none_hits = (panel.comparison[name].impacts for name in ("uniform", "none"))
            for damped, free in zip(uniform_hits, none_hits, strict=True):
                np.testing.assert_array_equal(damped.counts, free.counts, "no damping at all")
        assert panel.comparison["none"].numbers.decay > 0.5
        assert panel.comparison["dual"].numbers.bounces == 0.0


def test_two_word_lengths_and_cut_offs_give_figure_7_and_no_others() -> None:
    table = compare.word_lengths((0, 1, 2, 3, 4, 5, 6, 16))
    found = {(row.state_bits, round(1 / row.uniform_share)) for row in table if row.as_in_the_paper}
    assert found == {(4, 20), (2, 10)}
    wide = [row for row in table if row.state_bits == 16]
    assert all(row.uniform[rate] < 0.6 * row.none[rate] for row in wide for rate in row.none)


# --- figure 8 ---------------------------------------------------------------------------------------------


def test_velocity_at_20_khz_is_noisier_late_in_the_impact_and_null_only_in_fixed_point(figure_8: Any) -> None:
    profiles = figure_8
    slow, fast = profiles[2000, compare.FLOAT], profiles[20_000, compare.FLOAT]
    assert 5.0 < fast.noise_late / slow.noise_late < 10.0
    assert 1.2 < fast.noise_early / slow.noise_early < 3.0, "a fast handle shows less: many counts a period"
    assert slow.reading_late == pytest.approx(1.0, abs=0.1)
    assert fast.reading_late > 1.0, "noise, not null"
    null, dual = profiles[20_000, compare.FIXED], profiles[2000, compare.FIXED]
    assert (null.reading_early, null.reading_late) == (0.0, 0.0)
    assert null.delay_s is None
    assert null.noise_late == pytest.approx(profiles.speed_late, rel=0.01)
    assert 0.8 < dual.reading_late < 1.0


def test_the_delays_are_those_of_the_filters(figure_8: Any) -> None:
    """√2·T/(2·tan(π·fc·T)) plus half a period of the difference: 1.338 ms, and 0.249 ms at 20 kHz."""
    for (rate, cutoff_hz), share in {(2000, 200.0): 0.03, (20_000, 1000.0): 0.05}.items():
        expected = math.sqrt(2) / rate / (2 * math.tan(math.pi * cutoff_hz / rate)) + 0.5 / rate
        profile = figure_8[rate, compare.FLOAT]
        assert profile.cutoff_hz == cutoff_hz
        assert profile.delay_s == pytest.approx(expected, rel=share)
