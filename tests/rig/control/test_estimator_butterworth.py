"""The Butterworth filter of any order, against scipy's second-order sections and its own biquad of order 2."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from rig.control import estimators
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
