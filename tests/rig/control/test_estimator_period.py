"""Velocity from edge times: exact between edges, bounded without edges, zero where the count only toggles."""

import math
from bisect import bisect_right
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.control import estimators
from rig.control.estimators.arrays import run
from rig.control.estimators.estimator import WINDOW
from rig.core.errors import ConfigError

RESOLUTION, PERIOD = 1e-5, 5e-4
TICK = 62.5e-9  # of the edge time on the wire
CLOCK = 64e-9  # what two rounded edge times can be wrong together, and the host's whole nanoseconds
NAMES = ("period", "period-frequency")
SPEED = st.floats(0.03, 3000.0)  # counts per period


def prepare(name: str, **given: Any) -> Any:
    return estimators.get(name).prepare(given, RESOLUTION, PERIOD)


def on_the_wire(age_s: Any) -> Any:
    """Return edge ages (s) as the loop receives them: rounded to 1/16 µs of device time, then to nanoseconds."""
    return np.floor(np.rint(np.asarray(age_s) / TICK) * 62.5) * 1e-9


def steady(speed: float, start: float, samples: int) -> Any:
    """Return counts and edge ages at constant `speed` (counts per period) from `start` (counts) at sample 0."""
    position = start + speed * np.arange(samples)
    count = np.floor(position)
    beyond = position - count if speed > 0 else count + 1 - position  # travelled since the last boundary
    return count.astype(np.int64), beyond / abs(speed) * PERIOD


def velocities(prepared: Any, counts: Any, ages: Any, elapsed: Any = None) -> Any:
    steps = np.ones(len(counts), np.int64) if elapsed is None else np.asarray(elapsed, np.int64)
    return (
        run(prepared, np.asarray(counts, np.int64), np.asarray(ages, float), steps)[0] * PERIOD / RESOLUTION
    )


@given(
    speed=SPEED,
    sign=st.sampled_from((1, -1)),
    start=st.floats(0, 1, allow_subnormal=False),
    name=st.sampled_from(NAMES),
)
def test_steady_motion_reads_to_the_edges_resolution(speed: Any, sign: Any, start: float, name: Any) -> None:
    """The estimate holds from the second edge; its two edges are at least half a period or one count apart."""
    samples = 20 + math.ceil(4 / speed)
    counts, ages = steady(sign * speed, start, samples)
    v = velocities(prepare(name), counts, on_the_wire(ages))
    seen = np.flatnonzero(np.diff(counts))[1] + 1  # the sample that shows the second edge
    span = max(PERIOD / 2, PERIOD / speed)
    assert np.abs(v[seen:] / (sign * speed) - 1.0).max() <= CLOCK / span + 1e-9
    assert not v[: np.flatnonzero(np.diff(counts))[0] + 2].any()


def sampled(motion: Any, edges: Any, samples: int) -> Any:
    times = PERIOD * np.arange(samples)
    when = [t for t, _ in edges]
    last = [bisect_right(when, t) - 1 for t in times]
    ages = [t - when[i] if i >= 0 else 134.0 for t, i in zip(times, last, strict=True)]
    return np.floor(motion(times)).astype(np.int64), np.array(ages), last


def mean_velocities(edges: Any, last: Any) -> Any:
    """Return mean velocities between each sample's newest edges, bounded by the time since (counts per period)."""
    expected, speed = [], 0.0
    for k, (i, before) in enumerate(zip(last, [-1, *last], strict=False)):
        if i != before:
            (t, b), (t0, b0) = edges[i], edges[before]
            speed = (b - b0) / (t - t0) * PERIOD if before >= 0 else 0.0
        age = k * PERIOD - edges[i][0] if i >= 0 else 134.0
        expected.append(math.copysign(min(abs(speed), PERIOD / max(age, 1e-12)), speed) if speed else 0.0)
    return np.array(expected)


@pytest.mark.parametrize("turn_s", [0.0487, 0.0501, 0.0612])
def test_a_slow_reversal_reads_the_mean_velocity_between_true_edges(turn_s: float) -> None:
    """A parabola turns inside a cell: the velocity is positive, zero at the edge crossed back, then negative."""

    def motion(t: Any) -> Any:
        return 100.3 - 8000.0 * (t - turn_s) ** 2

    found = [(turn_s + way * math.sqrt((100.3 - b) / 8000.0), b) for b in range(60, 101) for way in (-1, 1)]
    edges = sorted((time_s, boundary) for time_s, boundary in found if time_s > 0.0)
    counts, ages, last = sampled(motion, edges, 200)
    v = velocities(prepare("period"), counts, ages)
    assert v == pytest.approx(mean_velocities(edges, last), abs=2e-4)
    turned = int(turn_s / PERIOD)
    assert (v[5:turned] > 0).all()
    back = next(k for k in range(turned, 200) if counts[k] < counts[k - 1])
    assert v[back] == 0.0
    assert (v[back + 1 :] <= 0).all()
    assert v[-1] < -0.1


@pytest.mark.parametrize("name", NAMES)
def test_a_handle_that_stops_decays_as_one_over_the_time_since_its_last_edge(name: Any) -> None:
    counts, ages = steady(5.0, 0.0, 20)
    rest = np.arange(1, 200)
    stopped = [*counts, *[counts[-1]] * len(rest)], [*ages, *(ages[-1] + rest * PERIOD)]
    v = velocities(prepare(name), *stopped)[20:]
    assert v == pytest.approx(1.0 / rest, rel=1e-3)
    assert (v * rest > 1.0).all()  # the bound is the loosest that the clock allows


@pytest.mark.parametrize("name", NAMES)
def test_a_handle_that_toggles_one_count_reads_zero(name: Any) -> None:
    """Crossing the same boundary to and fro is no net motion, so a wall at rest stays quiet."""
    counts, ages = [0] * 5 + [1, 0] * 30, [134.0] * 5 + [1e-4, 2e-4] * 30
    assert not velocities(prepare(name), counts, ages).any()


@pytest.mark.parametrize("name", NAMES)
def test_two_edges_within_a_period_leave_an_unknown_boundary_and_a_velocity_of_zero(name: Any) -> None:
    counts, ages = steady(0.8, 0.0, 20)
    last = counts[-1]
    there = [*counts, last, last + 1, last + 2]
    v = velocities(prepare(name), there, [*ages, 1e-4, 1e-4, 1e-4])
    assert v[19] == pytest.approx(0.8, rel=1e-9)
    assert v[20] == v[21] == 0.0  # unknown, and the first known one
    assert v[22] == pytest.approx(1.0)


def test_a_reversal_begins_a_new_window() -> None:
    """A mean over twenty periods would keep the wrong sign for ten of them after the reversal."""

    def motion(t: Any) -> Any:
        return 1000.3 - np.abs(2.0e4 * (t - 0.02015))

    found = [(0.02015 + way * (1000.3 - b) / 2.0e4, b) for b in range(580, 1001) for way in (-1, 1)]
    edges = sorted((time_s, boundary) for time_s, boundary in found if time_s > 0.0)
    counts, ages, _ = sampled(motion, edges, 80)
    v = velocities(prepare("period-frequency", window_s=20 * PERIOD), counts, ages)
    assert v[39] == pytest.approx(10.0, rel=1e-3)
    assert v[43:] == pytest.approx(-10.0, rel=1e-3)


@settings(max_examples=20)
@given(speed=st.floats(6.0, 40.0), start=st.floats(0, 1, allow_subnormal=False))
def test_uneven_encoder_lines_are_averaged_by_the_window(speed: float, start: float) -> None:
    """Every other boundary is 0.2 counts late, so the error is at most 0.2 counts over one period or over 32."""
    position = start + speed * np.arange(200)
    count = np.floor(position)
    count = np.where(count + 0.2 * (count % 2) <= position, count, count - 1)
    ages = (position - count - 0.2 * (count % 2)) / speed * PERIOD
    for periods in (1, 32):
        prepared = prepare("period-frequency", window_s=periods * PERIOD, unevenness=0.2)
        v = velocities(prepared, count, ages)[50:]
        least = (periods - 1.2 / speed) * speed  # counts between the two edges
        assert np.abs(v / speed - 1.0).max() <= 0.2 / (least - 0.2) + 1e-3


@given(
    data=st.lists(
        st.tuples(
            st.integers(-(2**31), 2**31 - 1),
            st.floats(allow_nan=True, allow_infinity=True),
            st.integers(1, 2**40),
        ),
        min_size=1,
        max_size=60,
    ),
    name=st.sampled_from(NAMES),
)
def test_any_counts_ages_and_gaps_give_a_finite_velocity(data: Any, name: Any) -> None:
    counts, ages, elapsed = zip(*data, strict=True)
    prepared = prepare(name)
    assert np.isfinite(velocities(prepared, counts, ages, elapsed)).all()
    assert prepared.state_i[WINDOW] >= (len(data) > 1)


@given(
    motion=st.lists(st.integers(-5, 5), min_size=2, max_size=100),
    ages=st.lists(st.floats(0, 2 * PERIOD), min_size=100, max_size=100),
    name=st.sampled_from(NAMES),
)
def test_velocity_is_at_most_a_count_since_last_edge(motion: list[int], ages: list[float], name: Any) -> None:
    ages = np.array(ages[: len(motion)])
    v = velocities(prepare(name), np.cumsum(motion), ages)
    used = np.where(np.diff(np.cumsum(motion), prepend=0) != 0, np.minimum(ages, PERIOD), ages)
    assert (np.abs(v) * np.maximum(used - TICK, 0.0) <= PERIOD * (1 + 1e-9)).all()


def test_without_edge_times_it_is_the_finite_difference_held_between_counts() -> None:
    counts = np.floor(0.3 * np.arange(60) ** 1.3).astype(int)
    v = estimators.estimate("period", counts, PERIOD, resolution=RESOLUTION)
    fdm = estimators.estimate("fdm", counts, PERIOD, resolution=RESOLUTION)
    each = np.diff(counts, prepend=0) > 0
    each[:8] = False
    consecutive = each & np.roll(each, 1)
    assert consecutive.sum() > 20
    assert v[consecutive] == pytest.approx(fdm[consecutive], rel=1e-9)


def test_the_row_shows_over_how_many_periods_it_looks() -> None:
    counts, ages = steady(0.1, 0.0, 60)
    prepared = prepare("period")
    velocities(prepared, counts, ages)
    assert prepared.state_i[WINDOW] == 10
    velocities(prepared, [counts[-1]], [ages[-1] + 50 * PERIOD], [50])
    assert prepared.state_i[WINDOW] == pytest.approx(50 + ages[-1] / PERIOD, abs=0.51)
    fast = prepare("period-frequency", window_s=8 * PERIOD)
    velocities(fast, *steady(7.3, 0.0, 60))
    assert fast.state_i[WINDOW] == 8


def test_a_window_beyond_the_memory_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"window_s = 0\.2 s spans 400 velocity periods.*at most 256 periods"
    ):
        prepare("period-frequency", window_s=0.2)
    assert prepare("period-frequency", window_s=1e-6).parameters[3] == 1.0
    assert prepare("period-frequency", window_s=3 * PERIOD).parameters[3] == 3.0
