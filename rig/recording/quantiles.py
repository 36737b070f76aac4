"""Which order statistics bound a quantile of the distribution that a sample comes from, whatever that distribution is.

The r-th smallest of N independent values lies above the q-quantile unless at least r of them lie below it, and how many
do is binomial. No tail is fitted. With too few values there is no bound: of a p99.9 an upper one at 95 % needs 2995 of
them.
"""

from __future__ import annotations

import numpy as np


def quantile_ranks(number: int, share: float, confidence: float) -> tuple[int, int | None, int | None]:
    """Rank (from 1) of a sample's quantile, and those of the tightest bounds below and above the true one.

    Parameters
    ----------
    number
        Values in the sample, at least one.
    share
        Of the values that the quantile does not exceed (0 … 1).
    confidence
        Of each bound by itself; a bound that would lie outside the sample is None.
    """
    rank = max(1, int(np.ceil(share * number - 1e-9)))
    centre, spread = share * number, np.sqrt(number * share * (1.0 - share))
    first = max(0, int(centre - 10.0 * spread - 10.0))
    last = min(number, int(centre + 10.0 * spread + 10.0))
    counts = np.arange(first, last)
    ratios = np.log((number - counts) / (counts + 1.0) * (share / (1.0 - share)))
    logarithms = np.concatenate([[0.0], np.cumsum(ratios)])
    weights = np.exp(logarithms - logarithms.max())
    weights /= weights.sum()
    below = np.cumsum(weights)  # P(at most first + i values lie below the quantile)
    above = np.cumsum(weights[::-1])[
        ::-1
    ]  # P(at least first + i); summed from the small end, where it matters
    low = first + int(np.searchsorted(below, 1.0 - confidence, side="right"))
    high = first + int(np.searchsorted(-above, confidence - 1.0))
    return rank, low if low >= 1 else None, high if high <= number else None
