"""Bounds of quantiles: what the binomial says, how often they hold, too few values."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special, stats

from rig.recording.quantiles import (
    CONFIDENCE,
    Distribution,
    Quantile,
    quantile,
    share_bounded_by_largest,
    values_needed,
)

SHARES = st.sampled_from([0.5, 0.9, 0.99, 0.999])


@pytest.mark.parametrize("confidence", [CONFIDENCE, 0.975])
@pytest.mark.parametrize("share", [0.5, 0.9, 0.99, 0.999])
@pytest.mark.parametrize("number", [1, 2, 5, 20, 58, 59, 298, 299, 1000, 2994, 2995, 5000])
def test_the_bounds_are_the_order_statistics_that_the_binomial_names(
    number: int, share: float, confidence: float
) -> None:
    """Oracle: a binomial summed here. Rank r bounds from above when fewer than r values lie below, surely enough."""
    n = np.arange(number + 1)
    chance = (
        special.comb(number, n) * share**n * (1.0 - share) ** (number - n)
        if number < 60
        else stats.binom.pmf(n, number, share)
    )
    below = np.cumsum(chance)  # below[r]: no more than r values lie below the quantile
    found = quantile(np.arange(1, number + 1), share, confidence)  # the value is its own rank
    upper = [r for r in range(1, number + 1) if below[r - 1] >= confidence]
    lower = [r for r in range(1, number + 1) if 1.0 - below[r - 1] >= confidence]
    assert found == Quantile(
        value=math.ceil(round(share * number, 9)),
        low=lower[-1] if lower else None,
        high=upper[0] if upper else None,
    )
    assert isinstance(found.value, int)


def test_the_bounds_of_a_million_values_hold_the_quantile_between_them() -> None:
    found = quantile(np.arange(1, 3_000_001), 0.999)
    below = stats.binom(3_000_000, 0.999)
    assert found.low is not None
    assert found.high is not None
    assert below.cdf(found.low - 1) <= 0.05 < below.cdf(found.low)
    assert below.cdf(found.high - 2) < 0.95 <= below.cdf(found.high - 1)


@given(st.lists(st.floats(0.0, 1e3), min_size=1, max_size=300), SHARES)
def test_a_quantile_lies_between_its_bounds_and_among_the_values(values: list[float], share: float) -> None:
    ordered = sorted(values)
    found = quantile(ordered, share)
    assert found.value in ordered
    assert found.low is None or found.low <= found.value
    assert found.high is None or found.high >= found.value


@pytest.mark.parametrize("draw", ["exponential", "uniform", "standard_cauchy"])
def test_whatever_the_distribution_the_bounds_hold_as_often_as_they_promise(draw: str) -> None:
    """1000 samples of 600 values: p99 lies outside each bound in at most 5 % of them, give or take three sigma."""
    rng = np.random.default_rng(5)
    truth = {"exponential": math.log(100.0), "uniform": 0.99, "standard_cauchy": stats.cauchy.ppf(0.99)}[draw]
    found = [quantile(np.sort(getattr(rng, draw)(size=600)), 0.99) for _ in range(1000)]
    allowed = (1.0 - CONFIDENCE) + 3.0 * math.sqrt(CONFIDENCE * (1.0 - CONFIDENCE) / 1000)
    assert np.mean([f.high is not None and f.high < truth for f in found]) <= allowed
    assert np.mean([f.low is not None and f.low > truth for f in found]) <= allowed


def test_a_bound_of_p999_needs_2995_values() -> None:
    needed = values_needed(0.999)
    assert needed == 2995
    assert quantile(np.arange(needed - 1.0), 0.999).high is None
    assert quantile(np.arange(float(needed)), 0.999).high == needed - 1.0


@given(st.integers(1, 100_000))
def test_the_largest_value_bounds_a_quantile_just_so(number: int) -> None:
    share = share_bounded_by_largest(number)
    assert 1.0 - share**number == pytest.approx(CONFIDENCE)
    few = Distribution.of(np.arange(number % 3000 + 1.0))
    assert few.almost_all == (few.maximum if few.p999.high is None else few.p999.high)
