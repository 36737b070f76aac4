"""The fixed-point Butterworth filter: bit-exact arithmetic, and the effect of word lengths on velocity."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from rig.control import estimators
from rig.control._fixed_point import ROUNDINGS, Biquad
from rig.control.estimators._fdm_butterworth_fixed import Y1, biquad
from rig.core.errors import ConfigError
from rig.testing.estimators import check_estimator, velocities
from tests.conformance.fixed_law import ExactFilter

RESOLUTION, PERIOD = 1e-5, 5e-4
ONE_COUNT = RESOLUTION / PERIOD

COUNT = st.integers(-(2**31), 2**31 - 1)
MOTION = st.lists(st.integers(-1000, 1000), min_size=1, max_size=60)
SETTINGS = st.fixed_dictionaries(
    {
        "cutoff_hz": st.sampled_from((20.0, 100.0, 200.0, 700.0)),
        "coefficient_bits": st.sampled_from((14, 20, 28)),
        "state_bits": st.integers(0, 20),
        "word_bits": st.integers(24, 32),
        "rounding": st.sampled_from(ROUNDINGS),
        "numerator": st.sampled_from(("unit-gain", "nearest")),
    }
)


def fixed(period_s: float = PERIOD, **given: Any) -> Any:
    return estimators.get("fdm-butterworth-fixed").prepare(given, RESOLUTION, period_s)


def design(**given: Any) -> Biquad:
    estimator = estimators.get("fdm-butterworth-fixed")
    return biquad({s.name: s.default for s in estimator.settings} | given, PERIOD)


def response(f: Biquad) -> tuple[np.ndarray, np.ndarray]:
    """Return impulse responses of the rounded coefficients: of the filter, and of 1/A, which filters rounding."""
    one = 2.0**f.coefficient_bits
    a = np.array([one, f.a1, f.a2]) / one
    impulse = np.eye(1, 4000)[0]
    return signal.lfilter(np.array([f.b0, f.b1, f.b2]) / one, a, impulse), signal.lfilter([1.0], a, impulse)


def largest_error(f: Biquad) -> float:
    """Return the largest error of the output by rounding (counts per period): e·Σ|g| LSB."""
    return (0.5 if f.rounding == 2 else 1.0) * np.abs(response(f)[1]).sum() * f.state.lsb


@given(counts=st.lists(COUNT, min_size=1, max_size=40), given=SETTINGS, data=st.data())
def test_fixed_filter_is_exact_arithmetic_to_the_bit(counts: Any, given: Any, data: st.DataObject) -> None:
    elapsed = data.draw(st.lists(st.integers(1, 60), min_size=len(counts), max_size=len(counts)))
    prepared, exact = fixed(**given), ExactFilter(design(**given))
    for count, steps in zip(counts, elapsed, strict=True):
        velocities(prepared, [count], [steps])
        assert prepared.state_i[Y1] == exact.velocity(count, steps)


@pytest.mark.parametrize("rounding", ROUNDINGS)
def test_every_rounding_passes_the_conformance_suite(rounding: Any) -> None:
    check_estimator("fdm-butterworth-fixed", {"rounding": rounding, "state_bits": 12}, linear=False)


def test_gap_of_days_reads_one_count() -> None:
    v = velocities(fixed(), [0, 10**9], [1, 10**9])
    assert v[1] == pytest.approx(ONE_COUNT, rel=1e-4)


@given(motion=MOTION, rounding=st.sampled_from(ROUNDINGS), cutoff_hz=st.sampled_from((100.0, 200.0, 500.0)))
def test_wide_words_give_the_float_filter(motion: Any, rounding: Any, cutoff_hz: Any) -> None:
    """28 and 18 bits err by at most e·Σ|g|·LSB by rounding outputs, plus max|x|·Σ|h − h'| by coefficients."""
    given = {"cutoff_hz": cutoff_hz, "coefficient_bits": 28, "state_bits": 18, "rounding": rounding}
    f = design(**given)
    counts = [0, *np.cumsum(motion).tolist()]
    section = signal.butter(2, cutoff_hz, fs=1 / PERIOD, output="sos")
    expected = signal.sosfilt(section, np.diff(counts, prepend=0))
    ideal = signal.sosfilt(section, np.eye(1, 4000)[0])
    bound = largest_error(f) + max(map(abs, motion)) * np.abs(ideal - response(f)[0]).sum()
    assert bound < 2e-4
    error = velocities(fixed(**given), counts) / ONE_COUNT - expected
    assert np.abs(error).max() <= bound + 1e-9


def steady(per_period: int, out_of: int = 1, **given: Any) -> float:
    """Return the settled velocity for `per_period` counts in `out_of` periods (counts per period)."""
    counts = [per_period * k // out_of for k in range(4000)]
    return float(velocities(fixed(**given), counts)[-200:].mean() / ONE_COUNT)


@pytest.mark.parametrize("numerator", ["unit-gain", "nearest"])
def test_a_fast_motion_is_scaled_by_the_gain_at_rest(numerator: str) -> None:
    given = {"cutoff_hz": 20.0, "numerator": numerator, "state_bits": 8}
    gain = design(**given).dc_gain
    assert gain == (1.0 if numerator == "unit-gain" else pytest.approx(61 / 62, rel=1e-9))
    assert steady(5000, **given) == pytest.approx(5000 * gain, rel=1e-4)


def test_a_velocity_beyond_the_word_saturates_and_keeps_its_sign() -> None:
    """A word of 16 bits with 4 fraction bits ends at 2048 counts a period."""
    given = {"word_bits": 16, "state_bits": 4}
    assert steady(5000, **given) == pytest.approx(2048, abs=1)
    assert steady(-5000, **given) == pytest.approx(-2048, abs=1)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"coefficient_bits": 14.5}, r"coefficient_bits = 14\.5 must be a whole number"),
        ({"state_bits": 20, "word_bits": 21}, r"Q1\.20 cannot represent one count"),
        ({"coefficient_bits": 30, "word_bits": 40}, r"overflow 64 bits"),
        ({"cutoff_hz": 1.0, "coefficient_bits": 8}, r"changes the filter.*more coefficient_bits than 8"),
        ({"cutoff_hz": 1000.0}, r"estimator fdm-butterworth-fixed: .*Nyquist frequency 1000 Hz"),
        ({"rounding": "even"}, r"rounding = 'even' is unknown.*floor, zero, nearest"),
    ],
)
def test_invalid_word_lengths_are_refused(given: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        fixed(**given)
