"""First-order adaptive windowing, best-fit: the slope of the longest acceptable least-squares line.

rise_i and span_i are the counts and periods between the newest sample and the i-th before it; the line is
rise = intercept + slope · span. The slope is that of equation (6), extended to samples with gaps. The intercept decides
which samples lie within the band; `anchor` selects it:

- `lsq`: the least-squares intercept (default);
- `last`: the line passes through the newest sample, as in some public implementations; use d ≥ 1.5;
- `literal`: a_n of equation (6) as printed in the paper, with 3 to 25 times the noise on a steady ramp.

`rig.control.estimators._foaw` explains band, window and stop rule. Experiments name it ``foaw-best``. Its update must
not allocate.
"""

from collections.abc import Mapping
from typing import Any

from rig.control.estimators import _foaw as foaw
from rig.control.estimators._foaw import BAND, COUNTS, LIMIT, MASK, PERIODS, SAMPLES, STOP, STOP_FIRST
from rig.control.estimators.estimator import PERIOD, RESOLUTION, WINDOW, Choice, Estimator, Floats, Ints
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

ANCHOR = foaw.OWN_PARAMETERS  # parameters
# state_f: the window copied from the ring in order, so that the band test is one loop without a modulo.
RISE, SPAN = 0, foaw.LONGEST + 1

ANCHORS = ("lsq", "last", "literal")
LSQ, LITERAL = ANCHORS.index("lsq"), ANCHORS.index("literal")


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
    """Return the velocity (rad/s or m/s): the slope of the longest least-squares line that fits the last counts.

    It is zero for the first sample.
    """
    newest = foaw.remember(count, elapsed_ticks, state_i)
    position, period = state_i[COUNTS + newest], state_i[PERIODS + newest]
    band, limit, anchor = parameters[BAND], int(parameters[LIMIT]), int(parameters[ANCHOR])
    stop_first = parameters[STOP] == STOP_FIRST
    # Equation (5) tests i = 1…n, as `literal` does; `last` contains the newest sample (0), `lsq` tests it too.
    first = 0 if anchor == LSQ else 1
    state_f[RISE], state_f[SPAN] = 0.0, 0.0
    sum_rise, sum_span, sum_product, sum_square = 0.0, 0.0, 0.0, 0.0
    best, window = 0.0, 0
    for n in range(1, min(state_i[SAMPLES] - 1, limit) + 1):
        oldest = (newest - n) & MASK
        periods = period - state_i[PERIODS + oldest]
        if periods > limit and n > 1:
            break
        rise, span = float(position - state_i[COUNTS + oldest]), float(periods)
        state_f[RISE + n], state_f[SPAN + n] = rise, span
        sum_rise += rise
        sum_span += span
        sum_product += rise * span
        sum_square += span * span
        points = n + 1
        slope = (points * sum_product - sum_span * sum_rise) / (points * sum_square - sum_span * sum_span)
        intercept = 0.0
        # `last`: a least-squares slope through one rounded sample can miss a true ramp by more than one count: about
        # one ramp window in fifty is cut at d = 1.
        if anchor == LSQ:
            intercept = (sum_rise - slope * sum_span) / points
        # As printed: where the chord of the two ends crosses t = 0, the start of the run. Turned about a point k
        # periods in the past, the line misses the newest samples by k · |slope − chord|, so that long windows fail.
        elif anchor == LITERAL:
            intercept = period * (rise / span - slope)
        # Counted to the end, not stopped at the first: the compiler makes vectors of this loop.
        outside = 0
        for i in range(first, n + 1):
            outside += abs(state_f[RISE + i] - slope * state_f[SPAN + i] - intercept) > band
        if n == 1 or outside == 0:
            best, window = slope, periods
        elif stop_first:
            break
    state_i[WINDOW] = window
    return float(best * parameters[RESOLUTION] / parameters[PERIOD])


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return four parameters: noise band (counts), longest window (periods), and the rules for stop and intercept."""
    return [*foaw.design(settings, resolution, period_s), float(ANCHORS.index(settings["anchor"]))]


ESTIMATOR = Estimator(
    name="foaw-best",
    summary="adaptive window, least-squares line",
    source="Janabi-Sharifi et al. (2000), best-fit; Chawda et al., equations (5) and (6)",
    update=update,
    floats=2 * (foaw.LONGEST + 1),
    ints=foaw.INTS,
    settings=(
        *foaw.SETTINGS,
        Choice(
            "anchor",
            "lsq",
            ANCHORS,
            "intercept of the line: least squares, through the newest sample, or as printed in the paper",
        ),
    ),
    design=design,
)
