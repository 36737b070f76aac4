"""Compare the cost of a verdict with the same filters and median from scipy and numpy, in one run.

pytest tests/benchmarks/test_verdict.py -o addopts="" -s
"""

import statistics
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt

from rig.control.judging import TrialSignals, judge, meter
from rig.control.verdict import KINDS, Kind, Measured, kinds
from tests.rig.control.test_verdict import LIMITS as LIMITS_OF_TESTS

RATE = 20_000
TIME = np.arange(RATE) / RATE
DELTA = 1.5708e-4
LIMITS = replace(LIMITS_OF_TESTS, felt_velocity=1.0)  # no floor spares the band pass
GOAL_US = 250.0


def hits() -> Any:
    """Return a hit of 1 s that rings and keeps buzzing: state columns as in a sweep, and counts."""
    states = np.zeros((RATE, 8))
    bounce = 1e-2 * np.exp(-TIME / 0.05) * np.sin(2 * np.pi * 60 * TIME)
    states[:, 2] = np.where(TIME < 0.03, -1e-2, 2e-3 + bounce) + 2e-4 * np.sin(2 * np.pi * 45 * TIME)
    states[:, 3] = np.gradient(states[:, 2], 1.0 / RATE)
    states[:, 5] = 0.15 - 300.0 * np.maximum(states[:, 2], 0.0)
    return states, np.floor(states[:, 2] / DELTA + 0.3) * DELTA


def median_us(call: Any, repeats: int = 60) -> Any:
    """Return the median CPU time of a call in this thread (µs)."""
    call()
    times = []
    for _ in range(repeats):
        started = time.thread_time_ns()
        call()
        times.append(time.thread_time_ns() - started)
    return statistics.median(times) / 1e3


def filter_with_scipy(position: Any, effort: Any) -> Any:
    """Compute only the numbers that need filters, over the whole trial."""
    high = butter(2, 30.0, "highpass", fs=RATE, output="sos")
    band = butter(2, [30.0, 500.0], "bandpass", fs=RATE, output="sos")
    started = sosfilt_zi(high)
    ripple = sosfilt(high, effort, zi=started * effort[0])[0][-8000:]
    swing = sosfilt(high, position, zi=started * position[0])[0][-8000:]
    felt = sosfiltfilt(band, np.gradient(position, 1.0 / RATE), padtype="even", padlen=2000)[-8000:]
    resting = np.median(position[-8000:])
    return np.sqrt(np.mean(felt**2)), np.sqrt(np.mean(ripple**2)), np.ptp(swing), resting


def test_a_verdict_costs_a_fraction_of_what_scipy_needs_for_its_filters_alone() -> None:
    states, counts = hits()
    effort, flags, nothing = np.ascontiguousarray(states[:, 5]), np.ones(RATE, np.int64), np.zeros(RATE, bool)
    measuring = meter(LIMITS, 1.0 / RATE, DELTA)
    numbers = measuring.recorded(counts, effort, counts, flags)
    expected = filter_with_scipy(counts, effort)
    assert numbers["felt"] == pytest.approx(expected[0], rel=1e-6)
    assert numbers["heard"] == pytest.approx(expected[1], rel=1e-6)
    signals = TrialSignals(
        tick_s=1.0 / RATE, resolution=DELTA, position=counts, velocity=None, effort=effort, penetration=counts,
        saturated=nothing, late=nothing, lost=np.zeros(RATE, np.int64),
        currents=np.zeros(RATE, np.int64), slew_bound=nothing, overruled=nothing,
    )  # fmt: skip
    recorded = median_us(lambda: measuring.recorded(counts, effort, counts, flags))
    true = median_us(lambda: measuring.true(states[:, 2], states[:, 3], states[:, 5], states[:, 2], flags))
    whole = median_us(lambda: judge(signals, LIMITS))
    scipy = median_us(lambda: filter_with_scipy(counts, effort))
    criteria = median_us(lambda: [Measured(numbers, LIMITS).passes(c) for c in ("felt", "heard", "any")])
    print(
        f"\n1 s at 20 kHz: recorded {recorded:.0f} µs, true (strided) {true:.0f} µs (goal {GOAL_US:.0f}); "
        f"judge {whole:.0f} µs; scipy's filters and a median {scipy:.0f} µs; three criteria {criteria:.0f} µs"
    )
    assert recorded < 0.5 * scipy
    assert true < 0.5 * scipy


def test_ten_thousand_verdicts_without_texts_cost_less_than_ten_trials() -> None:
    states, counts = hits()
    measuring = meter(LIMITS, 1.0 / RATE, DELTA)
    one = measuring.recorded(counts, states[:, 5], counts, np.ones(RATE, np.int64))
    numbers = np.full(10_000, one)
    per_trial = median_us(lambda: measuring.recorded(counts, states[:, 5], counts, np.ones(RATE, np.int64)))
    all_kinds = median_us(lambda: kinds(numbers, LIMITS))
    print(f"\nkinds of 10,000 trials: {all_kinds:.0f} µs")
    assert {KINDS[code] for code in kinds(numbers, LIMITS)} == {Measured(one, LIMITS).kind} <= set(Kind)
    assert all_kinds < 10.0 * per_trial
