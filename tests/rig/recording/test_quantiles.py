"""Confidence bounds of quantiles: the binomial formula, how often the bounds hold, and too few values."""

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


@pytest.mark.parametrize("confidence", [CONFIDENCE, 0.975])
@pytest.mark.parametrize("share", [0.5, 0.9, 0.99, 0.999])
@pytest.mark.parametrize("number", [1, 2, 5, 20, 58, 59, 298, 299, 1000, 2994, 2995, 5000])
def test_bounds_are_order_statistics_by_the_binomial(number: int, share: float, confidence: float) -> None:
    """Rank r is an upper bound if fewer than r values are below it with enough confidence; summed here as an oracle."""
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
