"""The age of the newest sample that has reached the law, on a line with delays and losses."""

import numpy as np
from numpy.typing import NDArray

LOST = -1


def ages(delays: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the age of the newest sample in each tick, as `sim_backend.bare.trial.run_ticks` takes them.

    `delays` are those of each sample from the law's first on (ticks), or `LOST`. A line keeps the order: a sample
    behind a late one is at least as late.
    """
    ticks = np.arange(len(delays))
    arrivals = np.maximum.accumulate(np.where(delays == LOST, 0, ticks + delays))
    arrived = (delays != LOST) & (arrivals < len(delays))
    newest = np.full(len(delays), -1)
    np.maximum.at(newest, arrivals[arrived], ticks[arrived])
    return np.asarray(ticks - np.maximum.accumulate(newest))
