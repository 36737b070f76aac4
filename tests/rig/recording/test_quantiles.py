"""Ranks that bound a quantile: the binomial's, too few values, and how often they hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom

from rig.recording.quantiles import quantile_ranks


@pytest.mark.parametrize(("ticks", "share"), [(1, 0.5), (20, 0.5), (299, 0.99), (1000, 0.99), (5000, 0.999)])
def test_the_bounds_of_a_quantile_are_those_of_the_binomial(ticks, share):
    """Against scipy: the tightest order statistics with at most 2.5 % beyond each."""
    rank, low, high = quantile_ranks(ticks, share, 0.975)
    assert rank == math.ceil(ticks * share)
    below = binom(ticks, share)
    if low is None:
        assert below.cdf(0) > 0.025
    else:
        assert below.cdf(low - 1) <= 0.025 < below.cdf(low)
    if high is None:
        assert below.sf(ticks - 1) > 0.025
    else:
        assert below.sf(high - 1) <= 0.025
        assert below.sf(high - 2) > 0.025


def test_few_ticks_do_not_bound_a_rare_quantile():
    """369 ticks are needed before the largest of them bounds the 99 % quantile at 97.5 %."""
    assert quantile_ranks(300, 0.99, 0.975)[2] is None
    assert quantile_ranks(400, 0.99, 0.975)[2] == 400


def test_bounds_hold_the_truth_nineteen_times_in_twenty():
    truth = -math.log(0.01) * 1e5  # 99 % quantile of an exponential wait
    rng = np.random.default_rng(5)
    _, low, high = quantile_ranks(2000, 0.99, 0.975)
    held = 0
    for _ in range(400):
        waits = np.sort(rng.exponential(1e5, 2000))
        held += waits[low - 1] <= truth <= waits[high - 1]
    assert held >= 0.92 * 400
