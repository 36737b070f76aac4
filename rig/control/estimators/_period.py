"""Velocity from the times of encoder edges: counts between two edges, divided by the time between them.

A count gives the position to within Δ; an edge gives it exactly, at the time of the edge. The message STATE contains
the count and the age of the last edge (`edge_age_s`, in steps of 1/16 µs). So every sample with a new edge gives one
exact point (E, b): the boundary b between two counts was crossed at time E. The estimate is the slope between the
newest two points,

    v = Δ·(b − b')/(E − E'),

the mean velocity from edge to edge, with a rounding noise of |δv|/v ≤ 64 ns/(E − E') only. With less than one edge
a period this is period counting; with more, it is the M/T method over one period. To average uneven encoder lines over
more than one period, use `rig.control.estimators._period_frequency`. Without edge times it is the finite difference,
held between counts. Experiments name it ``period``. Its update must not allocate.

Source: Ohmae et al. 1982, for the M/T method; the use of edges at both ends, reversal and decay are derived
from the geometry above.
"""

from collections.abc import Mapping
from typing import Any

from rig.control.estimators._fdm import count_difference
from rig.control.estimators.estimator import (
    COMMON,
    OWN_INTS,
    PERIOD,
    RESOLUTION,
    WINDOW,
    Estimator,
    Floats,
    Ints,
    Setting,
)
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

EDGE_TIME_S = 62.5e-9  # step of the edge time on the wire: an age may look too long by so much
OLDEST_EDGE_S = 134.0  # what the wire's 32-bit time can say; also stands for an age that is no number
# Periods. An edge so shortly after the previous sample is the same as in that sample: both times are rounded.
GRACE = 0.01

GAP = COMMON  # parameters: widest gap between two lines (counts)
# state_i: the last edge's boundary and direction
PREVIOUS, STARTED, KNOWN, UPWARDS = range(OWN_INTS, OWN_INTS + 4)
INTS = OWN_INTS + 4
# state_f: age of the last edge at the last sample; the slope's time (s) and value (counts/s)
AGE, SPAN, SPEED = range(3)
FLOATS = 3


@kernel("f8(f8)", inline=True)
def plausible_age(edge_age_s: float) -> float:
    """Return the age of the last encoder edge limited to 0 … `OLDEST_EDGE_S` (s); NaN becomes `OLDEST_EDGE_S`."""
    # `not <=` and not `>`: it takes NaN as well.
    if not edge_age_s <= OLDEST_EDGE_S:
        return OLDEST_EDGE_S
    return max(edge_age_s, 0.0)


@kernel("b1(i8, f8, f8, f8, f8)", inline=True)
def has_fresh_edge(moved: int, age: float, age_before: float, elapsed_s: float, period_s: float) -> bool:
    """Return True if there was an encoder edge since the previous sample: the count or the edge's time has changed."""
    within = elapsed_s - GRACE * period_s
    return moved != 0 or (age < within and age < age_before + within)


@kernel("i8(i8, i8, i8)", inline=True)
def boundary_distance(moved: int, upwards: int, upwards_before: int) -> int:
    """Return the counts from the boundary of the previous encoder edge to that of the last edge.

    `upwards` and `upwards_before` are 1 for an edge upwards and 0 for an edge downwards. Boundary c lies below count c:
    an edge up to count c crosses boundary c, an edge down to count c crosses boundary c + 1.
    """
    return moved - upwards + upwards_before


@kernel("f8(f8, f8, f8)", inline=True)
def still_possible(speed: float, age: float, gap: float) -> float:
    """Return `speed` (counts/s), limited to one `gap` between lines (counts) over the last edge's `age` (s)."""
    # In the time since the last edge the handle has not passed another line. The lines of a real encoder are not evenly
    # spaced: `unevenness` widens the gap, or a wide one at speed would look like a stop.
    silence = age - EDGE_TIME_S
    if abs(speed) * silence <= gap:
        return speed
    return gap / silence if speed > 0.0 else -gap / silence


@kernel("i8(f8, f8, f8)", inline=True)
def window(span: float, age: float, period_s: float) -> int:
    """Return the number of velocity periods between the last two edges, or since the last edge if that is longer."""
    return max(int(max(span, age) / period_s + 0.5), 1)


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
    """Return the velocity (rad/s or m/s): slope between the last two encoder edges, limited by the last one's age."""
    period_s, age = parameters[PERIOD], plausible_age(edge_age_s)
    elapsed_s = elapsed_ticks * period_s
    if state_i[STARTED] == 0:
        state_i[STARTED] = 1
    else:
        moved = count_difference(count, state_i[PREVIOUS])
        if has_fresh_edge(moved, age, state_f[AGE], elapsed_s, period_s):
            age = min(age, elapsed_s)
            # The last edge counts as one in the direction of the net motion. After a turn among several edges of one
            # period the distance is one count off, once.
            upwards = 1 if moved > 0 else 0
            state_f[SPAN], state_f[SPEED] = 0.0, 0.0
            # A fresh edge time with an unchanged count is an even number of edges, over an unknown boundary: restart. A
            # reversal over the last boundary is a distance of zero, so that a toggling count reads zero.
            if moved != 0 and state_i[KNOWN] != 0:
                span = max(state_f[AGE] + elapsed_s - age, EDGE_TIME_S)
                state_f[SPAN] = span
                state_f[SPEED] = boundary_distance(moved, upwards, state_i[UPWARDS]) / span
            state_i[KNOWN] = 1 if moved != 0 else 0
            state_i[UPWARDS] = upwards
        state_i[WINDOW] = window(state_f[SPAN], age, period_s)
    state_i[PREVIOUS] = count
    state_f[AGE] = age
    return float(still_possible(state_f[SPEED], age, parameters[GAP]) * parameters[RESOLUTION])


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return the estimator's only parameter: the widest gap between two encoder lines (counts)."""
    return [1.0 + settings["unevenness"]]


UNEVENNESS = Setting(
    "unevenness", 0.0, 0.0, 2.0, "count", "share by which a gap between edges may exceed one count"
)

ESTIMATOR = Estimator(
    name="period",
    summary="one count over the time between the last two edges, decaying while no edge comes",
    source="M/T method (Ohmae et al. 1982, cited second-hand) over one period",
    update=update,
    floats=FLOATS,
    ints=INTS,
    settings=(UNEVENNESS,),
    design=design,
)
