"""The velocity estimators: finite difference, and the Butterworth filter behind it."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from rig.control import estimators
from rig.control.estimators.estimator import Prepared, Setting
from rig.control.estimators.fdm import count_difference
from rig.core import plugins
from rig.core.errors import ConfigError
from rig.testing.estimators import check_estimator, velocities
from tests.conformance.estimator import KNOWN_LIMITS

ROOT = Path(__file__).parents[3]
RESOLUTION, PERIOD = 1e-5, 5e-4  # 10 µrad or µm; 2 kHz
CUTOFF = 200.0

COUNT = st.integers(-(2**31), 2**31 - 1)
MOTION = st.lists(st.integers(-1000, 1000), min_size=1, max_size=60)


def fdm(resolution: float = RESOLUTION, period_s: float = PERIOD) -> Prepared:
    return estimators.get("fdm").prepare({}, resolution, period_s)


def butterworth(
    resolution: float = RESOLUTION, period_s: float = PERIOD, cutoff_hz: float = CUTOFF
) -> Prepared:
    return estimators.get("fdm-butterworth").prepare({"cutoff_hz": cutoff_hz}, resolution, period_s)


# --- the family -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", estimators.names())
def test_every_estimator_keeps_the_promises_of_the_family(name: Any) -> None:
    check_estimator(name, **KNOWN_LIMITS.get(name, {}))


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="plain Python is what the test above has tried")
def test_every_estimator_keeps_them_as_plain_python_too() -> None:
    """Without the compiler the same text must run: coverage and debugging depend on it."""
    script = (
        "import numba\n"
        "assert numba.config.DISABLE_JIT\n"
        "from rig.control import estimators\n"
        "from rig.testing import check_estimator\n"
        "from tests.conformance.estimator import KNOWN_LIMITS\n"
        "for name in estimators.names():\n"
        "    check_estimator(name, **KNOWN_LIMITS.get(name, {}))\n"
        "    print(name)\n"
    )
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.stderr == ""
    assert done.stdout.split() == estimators.names()


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"no estimator 'fmd'.*fdm, fdm-butterworth"):
        estimators.get("fmd")


def test_a_broken_plug_in_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken:
        name, value, dist = "theirs", "theirs:ESTIMATOR", None

        def load(self) -> None:
            raise ImportError("no module named theirs")

    monkeypatch.setattr(plugins, "entry_points", lambda **_: [Broken()])
    with pytest.raises(ConfigError, match=r"theirs:ESTIMATOR.*does not load.*no module named theirs"):
        estimators.get("theirs")
    assert estimators.names()[-1] == "theirs"


# --- preparing --------------------------------------------------------------------------------------------


def test_an_unknown_setting_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"fdm-butterworth has no parameter 'cutof'.*cutoff_hz"):
        estimators.get("fdm-butterworth").prepare({"cutof": 200.0}, RESOLUTION, PERIOD)
    with pytest.raises(ConfigError, match=r"fdm has no parameter 'cutoff_hz'.*none"):
        estimators.get("fdm").prepare({"cutoff_hz": 200.0}, RESOLUTION, PERIOD)


@pytest.mark.parametrize("value", [0.0, -5.0, 2e6, math.inf, math.nan])
def test_a_setting_out_of_range_is_refused_with_value_and_range(value: Any) -> None:
    with pytest.raises(ConfigError, match=r"cutoff_hz = \S+ Hz is out of range.*choose .* to 1e\+06 Hz"):
        estimators.get("fdm-butterworth").prepare({"cutoff_hz": value}, RESOLUTION, PERIOD)


@pytest.mark.parametrize("cutoff_hz", [1000.0, 1200.0])
def test_a_cut_off_at_or_above_nyquist_cannot_be_realised(cutoff_hz: float) -> None:
    with pytest.raises(ConfigError, match=rf"cutoff_hz = {cutoff_hz:g} Hz .* Nyquist 1000 Hz.*200 Hz"):
        butterworth(cutoff_hz=cutoff_hz)
    butterworth(cutoff_hz=999.0)


def test_a_setting_without_a_default_must_be_given() -> None:
    base = estimators.get("fdm")
    needy = type(base)(
        base.name, "", "", base.update, 0, 2, (Setting("gain", None, 0.0, 1.0, "1/s", "how fast"),)
    )
    with pytest.raises(ConfigError, match=r"fdm needs gain.*give gain in 1/s: how fast"):
        needy.prepare({}, RESOLUTION, PERIOD)


# --- finite difference ------------------------------------------------------------------------------------


def test_the_first_sample_has_no_predecessor_and_reads_zero() -> None:
    assert velocities(fdm(), [123456])[0] == 0.0


@settings(deadline=None)
@given(slope=st.integers(-10_000, 10_000), start=st.integers(-(2**20), 2**20))
def test_a_ramp_is_read_exactly(slope: int, start: int) -> None:
    v = velocities(fdm(), [start + slope * k for k in range(5)])
    assert (v[1:] == slope * RESOLUTION / PERIOD).all()


def test_rounding_gives_a_moving_handle_a_noise_of_resolution_over_root_six_periods() -> None:
    """PHYSICS 2i (A) 2: two independent rounding errors of variance Δ²/12 divided by T. (0.0081 at 2 kHz, 10 µm.)"""
    k = np.arange(40_000)
    true = RESOLUTION * (0.37 * math.pi * k + 3000 * np.sin(0.0371 * k))
    counts = np.floor(true / RESOLUTION + 0.5).astype(int)
    error = velocities(fdm(), counts.tolist())[1:] - np.diff(true) / PERIOD
    assert np.std(error) == pytest.approx(RESOLUTION / (math.sqrt(6) * PERIOD), rel=0.02)
    assert abs(np.mean(error)) < 1e-3 * RESOLUTION / PERIOD


def test_over_a_gap_it_reads_the_mean_slope() -> None:
    v = velocities(fdm(), [0, 12], [1, 4])
    assert v[1] == pytest.approx(3 * RESOLUTION / PERIOD, rel=1e-15)


@settings(deadline=None)
@given(older=COUNT, moved=st.integers(-(2**31), 2**31 - 1))
def test_a_difference_of_counts_is_right_across_the_wrap_of_a_32_bit_counter(older: Any, moved: int) -> None:
    newer = (older + moved + 2**31) % 2**32 - 2**31
    assert count_difference(newer, older) == moved


@settings(max_examples=50, deadline=None)
@given(motion=MOTION, factor=st.sampled_from([-8, -1, 2, 16]), shift=COUNT)
def test_finite_difference_is_equivariant_under_shift_and_scale(motion: Any, factor: Any, shift: Any) -> None:
    """Exactly: a factor of two in the counts is one in the exponent, a shift cancels in integers."""
    counts = np.cumsum(motion)
    v = velocities(fdm(), counts.tolist())
    moved = [(int(factor * c + shift) + 2**31) % 2**32 - 2**31 for c in counts]
    assert (velocities(fdm(), moved) == factor * v).all()
    assert (velocities(fdm(-RESOLUTION), counts.tolist()) == -v).all()


# --- Butterworth ------------------------------------------------------------------------------------------


def lowpass(rate_hz: float = 1 / PERIOD, cutoff_hz: float = CUTOFF) -> Any:
    """The oracle: scipy's own design as second-order sections, run by scipy."""
    return signal.butter(2, cutoff_hz, fs=rate_hz, output="sos")


@settings(max_examples=50, deadline=None)
@given(motion=MOTION, cutoff_hz=st.floats(5.0, 900.0))
def test_the_output_is_scipys_filter_on_the_same_differences(motion: Any, cutoff_hz: float) -> None:
    counts = np.cumsum(motion).tolist()
    expected = signal.sosfilt(lowpass(cutoff_hz=cutoff_hz), velocities(fdm(), counts))
    mine = velocities(butterworth(cutoff_hz=cutoff_hz), counts)
    scale = max(1.0, float(np.abs(expected).max()))
    assert mine == pytest.approx(expected, rel=1e-9, abs=1e-12 * scale)


def test_the_filter_is_what_lfilter_makes_of_its_published_coefficients() -> None:
    random = np.random.default_rng(1)
    counts = np.cumsum(random.integers(-50, 50, 500)).tolist()
    b, a = signal.butter(2, CUTOFF, fs=1 / PERIOD)
    expected = signal.lfilter(b, a, velocities(fdm(), counts))
    assert velocities(butterworth(), counts) == pytest.approx(expected, rel=1e-12, abs=1e-15)


def coefficients(prepared: Prepared) -> tuple[np.ndarray, np.ndarray]:
    b0, b1, b2, a1, a2 = prepared.parameters[2:]
    return np.array([b0, b1, b2]), np.array([1.0, a1, a2])


@pytest.mark.parametrize(("rate_hz", "cutoff_hz"), [(2000, 200), (20_000, 200), (50_000, 20), (1000, 499)])
def test_gain_is_one_at_rest_and_half_power_at_the_cut_off(rate_hz: int, cutoff_hz: int) -> None:
    b, a = coefficients(butterworth(period_s=1 / rate_hz, cutoff_hz=cutoff_hz))
    assert b.sum() / a.sum() == pytest.approx(1.0, rel=1e-8)
    _, response = signal.freqz(b, a, worN=[cutoff_hz], fs=rate_hz)
    assert abs(response[0]) == pytest.approx(math.sqrt(0.5), rel=1e-8)


def test_delay_at_zero_frequency_is_1_088_ms_for_200_hz_at_2_khz() -> None:
    """PHYSICS 2i (A) 4, from the phase of the coefficients that run."""
    b, a = coefficients(butterworth())
    _, delay = signal.group_delay((b, a), w=[1e-3], fs=1 / PERIOD)
    assert delay[0] * PERIOD == pytest.approx(1.088e-3, abs=5e-7)
    closed = math.sqrt(2) * PERIOD / (2 * math.tan(math.pi * CUTOFF * PERIOD))
    assert delay[0] * PERIOD == pytest.approx(closed, rel=1e-9)


def test_under_constant_acceleration_it_lags_by_that_delay_and_half_a_period() -> None:
    """The whole chain, felt as phase lag: v is read T/2 + 1.088 ms late."""
    k = np.arange(2000)
    acceleration = 2 * RESOLUTION / PERIOD**2  # position k² counts: no rounding at all
    v = velocities(butterworth(), (k**2).tolist())
    late = k[-1] * PERIOD - v[-1] / acceleration
    assert late == pytest.approx(0.5 * PERIOD + 1.088e-3, abs=1e-6)


@settings(deadline=None)
@given(before=MOTION, moved=st.integers(-5000, 5000), lost=st.integers(1, 40))
def test_over_a_gap_the_filter_runs_once_for_each_lost_period_on_the_mean_slope(
    before: Any, moved: int, lost: int
) -> None:
    counts = [0, *np.cumsum(before).tolist()]
    slopes = [*velocities(fdm(), counts), *[moved * RESOLUTION / (lost * PERIOD)] * lost]
    expected = signal.sosfilt(lowpass(), slopes)[-1]
    seen = velocities(butterworth(), [*counts, counts[-1] + moved], [1] * len(counts) + [lost])[-1]
    assert seen == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_a_gap_of_days_costs_no_more_than_a_bounded_number_of_filter_steps() -> None:
    v = velocities(butterworth(), [0, 10**9], [1, 10**9])
    assert v[1] == pytest.approx(RESOLUTION / PERIOD, rel=1e-9)


@settings(max_examples=50, deadline=None)
@given(counts=st.lists(COUNT, min_size=1, max_size=50))
def test_any_counts_give_finite_velocities(counts: Any) -> None:
    assert np.isfinite(velocities(butterworth(), counts)).all()


@settings(max_examples=50, deadline=None)
@given(motion=MOTION, shift=st.integers(-(2**20), 2**20))
def test_the_filter_is_equivariant_under_shift_scale_and_sign(motion: Any, shift: int) -> None:
    counts = np.cumsum(motion)
    v = velocities(butterworth(), counts.tolist())
    assert (velocities(butterworth(), (counts + shift).tolist()) == v).all()
    assert (velocities(butterworth(), (4 * counts).tolist()) == 4 * v).all()
    assert (velocities(butterworth(-RESOLUTION), counts.tolist()) == -v).all()
