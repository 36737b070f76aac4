"""The basic velocity estimators: finite difference, and finite difference with a Butterworth filter."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control import estimators
from rig.control.estimators._fdm import count_difference
from rig.control.estimators.estimator import Prepared, Setting
from rig.core.errors import ConfigError
from rig.testing.estimators import check_estimator, velocities
from tests.conformance.estimator import KNOWN_LIMITS

RESOLUTION, PERIOD = 1e-5, 5e-4  # 10 µrad or µm; 2 kHz

COUNT = st.integers(-(2**31), 2**31 - 1)


def butterworth(cutoff_hz: float = 200.0) -> Prepared:
    return estimators.get("fdm-butterworth").prepare({"cutoff_hz": cutoff_hz}, RESOLUTION, PERIOD)


@pytest.mark.parametrize("name", estimators.names())
def test_every_estimator_keeps_the_promises_of_the_family(name: Any) -> None:
    check_estimator(name, **KNOWN_LIMITS.get(name, {}))


def test_an_unknown_setting_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"fdm-butterworth: unknown parameter 'cutof'.*cutoff_hz"):
        estimators.get("fdm-butterworth").prepare({"cutof": 200.0}, RESOLUTION, PERIOD)
    with pytest.raises(ConfigError, match=r"fdm: unknown parameter 'cutoff_hz'.*none"):
        estimators.get("fdm").prepare({"cutoff_hz": 200.0}, RESOLUTION, PERIOD)


@pytest.mark.parametrize("value", [0.0, -5.0, 2e6, math.inf, math.nan])
def test_a_setting_out_of_range_is_refused_with_value_and_range(value: Any) -> None:
    with pytest.raises(ConfigError, match=r"cutoff_hz = \S+ Hz is out of range.*choose .* to 1e\+06 Hz"):
        estimators.get("fdm-butterworth").prepare({"cutoff_hz": value}, RESOLUTION, PERIOD)


@pytest.mark.parametrize("cutoff_hz", [1000.0, 1200.0])
def test_a_cut_off_at_or_above_nyquist_cannot_be_realised(cutoff_hz: float) -> None:
    with pytest.raises(ConfigError, match=rf"cutoff_hz = {cutoff_hz:g} Hz .* Nyquist .* 1000 Hz.*200 Hz"):
        butterworth(cutoff_hz=cutoff_hz)
    butterworth(cutoff_hz=999.0)


def test_a_setting_without_a_default_must_be_given() -> None:
    base = estimators.get("fdm")
    needy = type(base)(
        base.name, "", "", base.update, 0, 2, (Setting("gain", None, 0.0, 1.0, "1/s", "how fast"),)
    )
    with pytest.raises(ConfigError, match=r"fdm needs the setting gain.*give gain in 1/s: how fast"):
        needy.prepare({}, RESOLUTION, PERIOD)


@given(older=COUNT, moved=st.integers(-(2**31), 2**31 - 1))
def test_count_difference_is_right_across_the_counters_wrap(older: Any, moved: int) -> None:
    newer = (older + moved + 2**31) % 2**32 - 2**31
    assert count_difference(newer, older) == moved


def test_a_gap_of_days_costs_no_more_than_a_bounded_number_of_filter_steps() -> None:
    v = velocities(butterworth(), [0, 10**9], [1, 10**9])
    assert v[1] == pytest.approx(RESOLUTION / PERIOD, rel=1e-9)
