"""Period counting at low speed, frequency counting at high speed: the M/T method over a window of edges.

v = Δ·(b − b')/(E − E') as in `rig.control.estimators._period`, but E' is the last edge before the window, which began
`window_s` ago. At high speed many counts are divided by an exact time, so that uneven encoder lines (edges displaced by
p counts) cause an error of at most 2p·Δ/window_s. At low speed edges are further apart than the window, and the method
is period counting.

The delay is half the window. A reversal, or an edge whose boundary is unknown, starts a new window. Between edges the
estimate is held, but limited to (1 + unevenness)·Δ/a, with a the age of the last edge. Experiments name it
``period-frequency``. Its update must not allocate.

Source: Ohmae et al. 1982 (a gate time plus the time until the next edge; here both ends are edges).
"""

import math
from collections.abc import Mapping
from typing import Any

from rig.control.estimators import _period as period
from rig.control.estimators._fdm import count_difference
from rig.control.estimators._period import (
    AGE,
    EDGE_TIME_S,
    GAP,
    KNOWN,
    PREVIOUS,
    SPAN,
    SPEED,
    STARTED,
    UPWARDS,
    has_fresh_edge,
    plausible_age,
    still_possible,
    window,
)
from rig.control.estimators.estimator import PERIOD, RESOLUTION, WINDOW, Estimator, Floats, Ints, Setting
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

GATE = GAP + 1  # parameters: the window in velocity periods
LONGEST = 256
SLOTS = LONGEST + 2  # edges in memory: one for each period of the window, and the one before it
# state_i: periods, counts since the start; edges
NOW, PLACE, OLDEST, NEWEST = range(period.INTS, period.INTS + 4)
SAMPLES = NEWEST + 1  # state_i: for each slot the period in which its edge was seen …
BOUNDARIES = SAMPLES + SLOTS  # … and its boundary
AGES = period.FLOATS  # state_f: and its age then (s)


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
    """Return the velocity (rad/s or m/s): slope from the last edge before a window to the newest edge.

    Between edges it is limited by the time since the newest edge.
    """
    period_s, age = parameters[PERIOD], plausible_age(edge_age_s)
    elapsed_s = elapsed_ticks * period_s
    if state_i[STARTED] == 0:
        state_i[STARTED] = 1
    else:
        moved = count_difference(count, state_i[PREVIOUS])
        now = state_i[NOW] + elapsed_ticks
        state_i[NOW], state_i[PLACE] = now, state_i[PLACE] + moved
        if has_fresh_edge(moved, age, state_f[AGE], elapsed_s, period_s):
            age = min(age, elapsed_s)
            upwards = 1 if moved > 0 else 0
            boundary = state_i[PLACE] + 1 - upwards
            oldest, newest = state_i[OLDEST], state_i[NEWEST]  # edges oldest … newest − 1 are in memory
            turned = upwards != state_i[UPWARDS]
            # An unchanged count with a new edge time: which boundary was crossed is unknown.
            if moved == 0 or state_i[KNOWN] == 0:
                oldest = newest
            elif turned:
                oldest = newest - 1
            began = now - int(parameters[GATE])
            # The last edge before the window remains in memory: the slope begins there.
            while oldest < newest - 1 and state_i[SAMPLES + (oldest + 1) % SLOTS] <= began:
                oldest += 1
            state_f[SPAN], state_f[SPEED] = 0.0, 0.0
            if oldest < newest:
                slot = oldest % SLOTS
                span = (now - state_i[SAMPLES + slot]) * period_s + state_f[AGES + slot] - age
                state_f[SPAN] = max(span, EDGE_TIME_S)
                state_f[SPEED] = (boundary - state_i[BOUNDARIES + slot]) / state_f[SPAN]
            slot = newest % SLOTS
            state_i[SAMPLES + slot], state_i[BOUNDARIES + slot], state_f[AGES + slot] = now, boundary, age
            state_i[OLDEST], state_i[NEWEST] = newest if turned else oldest, newest + 1
            state_i[KNOWN] = 1 if moved != 0 else 0
            state_i[UPWARDS] = upwards
        state_i[WINDOW] = window(state_f[SPAN], age, period_s)
    state_i[PREVIOUS] = count
    state_f[AGE] = age
    return float(still_possible(state_f[SPEED], age, parameters[GAP]) * parameters[RESOLUTION])


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return two parameters: the widest gap between two encoder lines (counts), and the window (periods, rounded up).

    Raises `ConfigError` if the window is longer than the memory of `LONGEST` periods.
    """
    periods = math.ceil(settings["window_s"] / period_s * (1.0 - 1e-9))
    if periods > LONGEST:
        raise ConfigError(
            f"estimator period-frequency: window_s = {settings['window_s']:g} s spans {periods} "
            f"velocity periods, more than {LONGEST}",
            remedy=f"choose at most {LONGEST} periods, {LONGEST * period_s:g} s",
        )
    return [*period.design(settings, resolution, period_s), float(periods)]


ESTIMATOR = Estimator(
    name="period-frequency",
    summary="counts between encoder edges a window apart over the exact time between them",
    source="M/T method (Ohmae et al. 1982, cited second-hand)",
    update=update,
    floats=period.FLOATS + SLOTS,
    ints=SAMPLES + 2 * SLOTS,
    settings=(
        Setting(
            "window_s", 1e-3, 1e-6, 1.0, "s", "shortest time between the two edges, rounded to whole periods"
        ),
        period.UNEVENNESS,
    ),
    design=design,
)
