"""Butterworth filters of any order, and the sections of high passes and band passes, against scipy."""

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import signal

from rig.control import estimators
from rig.control._butterworth import band_pass, high_pass
from rig.core.errors import ConfigError
from rig.testing.estimators import check_estimator, velocities

RESOLUTION, PERIOD = 1e-5, 5e-4
MOTION = st.lists(st.integers(-1000, 1000), min_size=1, max_size=60)
ORDERS = range(1, 9)


def butterworth(**given: Any) -> Any:
    return estimators.get("fdm-butterworth").prepare(given, RESOLUTION, PERIOD)


def differences(counts: Any) -> Any:
    return velocities(estimators.get("fdm").prepare({}, RESOLUTION, PERIOD), counts)


@given(motion=MOTION, order=st.sampled_from(ORDERS), cutoff_hz=st.floats(20.0, 900.0))
def test_each_order_is_scipys_filter(motion: Any, order: Any, cutoff_hz: float) -> None:
    counts = np.cumsum(motion).tolist()
    sections = signal.butter(order, cutoff_hz, fs=1 / PERIOD, output="sos")
    expected = signal.sosfilt(sections, differences(counts))
    scale = max(1.0, float(np.abs(expected).max()))
    seen = velocities(butterworth(order=order, cutoff_hz=cutoff_hz), counts)
    assert seen == pytest.approx(expected, rel=1e-9, abs=1e-11 * scale)


@pytest.mark.parametrize("order", [1, 3, 8])
def test_every_order_keeps_the_promises_of_the_family(order: int) -> None:
    check_estimator("fdm-butterworth", {"order": order})


@given(before=MOTION, moved=st.integers(-5000, 5000), lost=st.integers(1, 40))
def test_over_a_gap_every_section_runs_once_for_each_lost_period(before: Any, moved: int, lost: int) -> None:
    counts = [0, *np.cumsum(before).tolist()]
    slopes = [*differences(counts), *[moved * RESOLUTION / (lost * PERIOD)] * lost]
    expected = signal.sosfilt(signal.butter(5, 200.0, fs=1 / PERIOD, output="sos"), slopes)[-1]
    seen = velocities(butterworth(order=5), [*counts, counts[-1] + moved], [1] * len(counts) + [lost])[-1]
    assert seen == pytest.approx(expected, rel=1e-9, abs=1e-11)


@pytest.mark.parametrize(
    ("order", "message"),
    [(0, "is out of range.*1 to 8"), (9, "is out of range.*1 to 8"), (2.5, "must be a whole number")],
)
def test_invalid_order_is_refused(order: float, message: str) -> None:
    with pytest.raises(ConfigError, match=f"order = {order}.*{message}"):
        butterworth(order=order)


# Other sections, of the measures of a trial.

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
