"""First-order adaptive windowing, end-fit: the slope of the longest chord that ends at the newest sample.

Sample i lies within the band of a line through the newest sample if and only if the slope of the line is in the cone
[(rise_i − d)/span_i, (rise_i + d)/span_i]. So a chord is accepted if its slope lies in the cones of all samples in
between. `rig.control.estimators._foaw` explains band, window and stop rule. Experiments name it ``foaw-end``. Its
update must not allocate.
"""

import math

from rig.control.estimators import _foaw as foaw
from rig.control.estimators._foaw import BAND, COUNTS, LIMIT, MASK, PERIODS, SAMPLES, STOP, STOP_FIRST
from rig.control.estimators.estimator import PERIOD, RESOLUTION, WINDOW, Estimator, Floats, Ints
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE


@kernel(ESTIMATOR_SIGNATURE, no_refcount=True)
def update(
    count: int,
    edge_age_s: float,
    elapsed_ticks: int,
    effort: float,
    state_f: Floats,
    state_i: Ints,
    parameters: Floats,
) -> float:
    """Return the velocity (rad/s or m/s): slope of the longest chord that fits the counts in between, 0 at first."""
    newest = foaw.remember(count, elapsed_ticks, state_i)
    position, period = state_i[COUNTS + newest], state_i[PERIODS + newest]
    band, limit = parameters[BAND], int(parameters[LIMIT])
    stop_first = parameters[STOP] == STOP_FIRST
    slope, window = 0.0, 0
    lowest, highest = -math.inf, math.inf
    for n in range(1, min(state_i[SAMPLES] - 1, limit) + 1):
        oldest = (newest - n) & MASK
        span = period - state_i[PERIODS + oldest]
        if span > limit and n > 1:
            break
        per_period = 1.0 / span
        chord = (position - state_i[COUNTS + oldest]) * per_period
        if lowest <= chord <= highest:
            slope, window = chord, span
        elif stop_first or lowest > highest:
            break
        # One more sample adds one cone to the intersection of all: O(W). To test every sample again would cost O(W²)
        # and give the same window.
        lowest = max(lowest, chord - band * per_period)
        highest = min(highest, chord + band * per_period)
    state_i[WINDOW] = window
    return float(slope * parameters[RESOLUTION] / parameters[PERIOD])


ESTIMATOR = Estimator(
    name="foaw-end",
    summary="adaptive window, chord through its two ends",
    source="Janabi-Sharifi et al. (2000), end-fit; Chawda et al., equation (5)",
    update=update,
    floats=0,
    ints=foaw.INTS,
    settings=foaw.SETTINGS,
    design=foaw.design,
)
