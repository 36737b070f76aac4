"""The share of damping that is rendered if one count saturates the motor: closed forms and effects on widths."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from rig import config
from rig.config import presets
from rig.config.schemes import Scheme
from rig.control.estimators import names
from rig.experiments.mapping._rendering import rendered_share
from rig.experiments.mapping.zwidth import Boundary, Width, ZWidth
from tests.conformance.maps import short_map

COARSE = {"rig.encoder.ratio": 1.0, "rig.limits.effort": 0.6, "wall.stiffness": 20.0}
RIG = config.override(presets.load("koul-rigid"), COARSE)
DELTA, LIMIT = RIG.rig.encoder.resolution, 0.6


def rig_under(scheme: str) -> Any:
    return Scheme.parse(scheme).applied(RIG)


@pytest.mark.parametrize("rate", [1000, 20_000])
def test_of_an_unfiltered_difference_limit_times_period_over_count_is_rendered(rate: int) -> None:
    experiment, most = rig_under(f"uniform:{rate},estimator=fdm"), LIMIT / rate / DELTA
    for damping in (0.5 * most, most, 3.0 * most, 100.0 * most):
        assert rendered_share(experiment, damping) * damping == pytest.approx(min(damping, most), rel=1e-12)


def test_of_a_filtered_difference_the_pulse_of_the_filter_is_cut_off() -> None:
    """Compare with scipy: the difference of one count through a Butterworth of order 2 at 200 Hz and 2 kHz."""
    pulse = np.zeros(4096)
    pulse[0] = DELTA * 2000.0
    velocity = signal.lfilter(*signal.butter(2, 200.0, fs=2000.0), pulse)
    for damping in (0.1, 1.0, 10.0):
        expected = np.clip(damping * velocity, -LIMIT, LIMIT).sum() / (damping * velocity).sum()
        assert rendered_share(rig_under("dual:20k/2k"), damping) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    "estimator", sorted(set(names()) - {"fdm-butterworth-fixed", "disturbance-two-mass"})
)
def test_no_damping_is_rendered_whole_and_a_small_one_is(estimator: str) -> None:
    experiment = config.override(RIG, {"controller.estimator": estimator, "controller.parameters": {}})
    assert rendered_share(experiment, 0.0) == 1.0
    assert rendered_share(experiment, 1e-9) == pytest.approx(1.0, abs=1e-9)


@given(st.lists(st.floats(1e-6, 1e3), min_size=2, max_size=6))
def test_more_damping_is_rendered_by_a_smaller_share(dampings: list[float]) -> None:
    shares = [rendered_share(rig_under("uniform:20k"), damping) for damping in sorted(dampings)]
    assert shares == sorted(shares, reverse=True)
    assert all(0.0 < share <= 1.0 + 1e-12 for share in shares)


def width_of(*columns: tuple[float, float, float]) -> Width:
    """Return the width of a map; each column is a damping, a stiffness limit and a rendered share."""
    plan = short_map(0.1)
    boundaries = tuple(
        Boundary(0, damping, "any", limit, 0.0, limit, limit, 0, 0, (), rendered)
        for damping, limit, rendered in columns
    )
    return ZWidth(plan, boundaries, hits=0, series=()).width(0, "any")


def test_a_damping_that_is_not_rendered_counts_towards_no_measure() -> None:
    found = width_of((0.0, 10.0, 1.0), (1.0, 20.0, 0.9), (2.0, 90.0, 0.79), (3.0, 99.0, 0.1))
    assert (found.stiffness_peak, found.damping_at_peak) == (20.0, 1.0)
    assert (found.damping_range, found.area) == (1.0, 15.0)
    assert found.not_rendered == (2.0, 3.0)
    assert not found.range_capped
