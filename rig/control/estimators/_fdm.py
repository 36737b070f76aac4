"""Finite difference: the slope between two samples, without a filter.

v = Δ·(c_k − c_{k−1}) / T. On a moving handle the rounding of counts alone causes noise of Δ/(√6·T) rms, too much
to render damping at a high rate. Source: Chawda et al., equation (1).

Experiments name it ``fdm``. Its update must not allocate.
"""

from rig.control.estimators.estimator import OWN_INTS, PERIOD, RESOLUTION, WINDOW, Estimator, Floats, Ints
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

PREVIOUS, STARTED = OWN_INTS, OWN_INTS + 1  # state_i
INTS = OWN_INTS + 2
WRAP = 1 << 32


@kernel("i8(i8, i8)", inline=True)
def count_difference(newer: int, older: int) -> int:
    """Return `newer` − `older`, two counts of a 32-bit counter that may have wrapped between them."""
    return ((newer - older + WRAP // 2) & (WRAP - 1)) - WRAP // 2


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
    """Return the velocity (rad/s or m/s) at a new encoder count: travel / time since the last count, 0 at first."""
    if state_i[STARTED] == 0:
        state_i[STARTED] = 1
        state_i[PREVIOUS] = count
        return 0.0
    moved = count_difference(count, state_i[PREVIOUS])
    state_i[PREVIOUS] = count
    state_i[WINDOW] = elapsed_ticks
    return float(moved * parameters[RESOLUTION] / (elapsed_ticks * parameters[PERIOD]))


ESTIMATOR = Estimator(
    name="fdm",
    summary="finite difference of two samples, unfiltered",
    source="Chawda et al., equation (1)",
    update=update,
    floats=0,
    ints=INTS,
)
