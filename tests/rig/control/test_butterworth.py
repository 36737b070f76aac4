"""Butterworth second-order sections equal scipy's, in the same order."""

from typing import Any

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import signal

from rig.control._butterworth import band_pass, high_pass

RATES = st.sampled_from([500.0, 1000.0, 2000.0, 3333.0, 20_000.0, 50_000.0])
SHARES = st.floats(1e-3, 0.495)  # of the rate


def check(sections: Any, expected: Any) -> None:
    """Compare sections; a dozen operations round to about 1e-15 of a coefficient, and of the gain relatively."""
    np.testing.assert_allclose(np.array(sections)[1:], expected[1:], rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(sections[0][:3], expected[0, :3], rtol=1e-12)
    np.testing.assert_allclose(sections[0][3:], expected[0, 3:], rtol=0.0, atol=1e-13)


@given(st.sampled_from([2, 4]), SHARES, RATES)
def test_a_high_pass(order: int, share: float, rate_hz: float) -> None:
    expected = signal.butter(order, share * rate_hz, "highpass", fs=rate_hz, output="sos")
    check(high_pass(order, share * rate_hz, rate_hz), expected)


@given(SHARES, SHARES, RATES)
def test_a_band_pass(one: float, other: float, rate_hz: float) -> None:
    low, high = sorted((one, other))
    assume(high > 1.2 * low)
    assume(abs(low + high - 0.5) > 1e-9)  # else rounding decides which of two mirrored pole pairs is first
    edges = [low * rate_hz, high * rate_hz]
    expected = signal.butter(2, edges, "bandpass", fs=rate_hz, output="sos")
    check(band_pass(*edges, rate_hz), expected)
