"""The hybrid of FOAW and Levant: only one of them where its weight is 1, a weighted sum between."""

from typing import Any

import numpy as np
import pytest

from rig.control import estimators
from rig.control.estimators import arrays
from rig.core.errors import ConfigError
from tests.conformance.estimator_accuracy import case_of

NAME = "foaw-levant"
RESOLUTION, PERIOD = 2e-5, 5e-4  # a coarse linear encoder at 2 kHz
BOUND = 25.0


def run_both(counts: Any, period_s: Any = PERIOD, resolution: Any = RESOLUTION, **given: Any) -> Any:
    levant = {k: v for k, v in given.items() if k not in ("fast_window", "slow_window")}
    return (
        *arrays.estimate_with_window("foaw-end", counts, period_s, resolution=resolution),
        arrays.estimate("levant", counts, period_s, resolution=resolution, **levant),
        arrays.estimate(NAME, counts, period_s, resolution=resolution, **given),
    )


def test_every_sample_is_the_weighted_mean_of_the_two_that_it_documents() -> None:
    counts = case_of("wall-bounce", 1 / PERIOD, RESOLUTION).counts
    foaw, window, levant, hybrid = run_both(counts, lipschitz=BOUND, fast_window=2.0, slow_window=8.0)
    straight = np.clip((window - 2.0) / 6.0, 0.0, 1.0)
    levant_bound = 2 * np.sqrt(BOUND * RESOLUTION)
    with np.errstate(divide="ignore"):
        foaw_bound = RESOLUTION / (window * PERIOD)
    weight = straight * levant_bound**2 / (levant_bound**2 + foaw_bound**2)
    assert hybrid == pytest.approx(weight * foaw + (1 - weight) * levant, rel=1e-12, abs=1e-15)
    assert 0.0 < weight.max() < 1.0
    assert weight.min() == 0.0


def test_the_window_in_the_row_is_that_of_foaw() -> None:
    counts = case_of("wall-bounce", 1 / PERIOD, RESOLUTION).counts
    expected = arrays.estimate_with_window("foaw-end", counts, PERIOD, resolution=RESOLUTION)[1]
    assert (arrays.estimate_with_window(NAME, counts, PERIOD, resolution=RESOLUTION)[1] == expected).all()


def test_windows_out_of_order_and_gains_out_of_region_are_refused() -> None:
    prepare = estimators.get(NAME).prepare
    with pytest.raises(ConfigError, match=r"fast_window = 8, slow_window = 8 .* not in order"):
        prepare({"fast_window": 8.0}, RESOLUTION, PERIOD)
    with pytest.raises(ConfigError, match=r"slow_window = 30 and window_limit = 16 .* not in order"):
        prepare({"slow_window": 30.0}, RESOLUTION, PERIOD)
    with pytest.raises(ConfigError, match=r"foaw-levant: mu1 = 1\.5, mu2 = 3 lie outside the region 'hba'"):
        prepare({"gains": "hba", "mu1": 1.5, "mu2": 3.0}, RESOLUTION, PERIOD)
