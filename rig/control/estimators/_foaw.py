"""First-order adaptive windowing: the slope of the longest straight line that fits the last samples.

A line over the last n periods is accepted if every sample in between lies within the noise band d of it. Fast motion
bends soon, so the window and its delay are short. Slow motion is straight for long, so the window is long and the noise
small. The delay is about half the window; the window is stored with each estimate (`WINDOW`).

There are two estimators, which draw the line differently (only `foaw-best` has a choice of the line's anchor):

- `foaw-end` (`rig.control.estimators._foaw_end`): the chord through the newest and the oldest sample;
- `foaw-best` (`rig.control.estimators._foaw_best`): the least-squares line.

This file has the memory of samples and the settings of both estimators. After a gap longer than the window, the
estimate restarts from the mean slope over the gap.

Source: Janabi-Sharifi, Hayward and Chen, IEEE TCST 8(6), 2000, as given by Chawda et al., section II.C.
"""

from collections.abc import Mapping
from typing import Any

from rig.control.estimators._fdm import count_difference
from rig.control.estimators.estimator import COMMON, OWN_INTS, Choice, Ints, Setting
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel

LONGEST = 64  # periods; the delay of a longer line is too large for rendering
SLOTS, MASK = 128, 127  # ring of samples: a power of two above LONGEST

BAND, LIMIT, STOP = COMMON, COMMON + 1, COMMON + 2  # parameters
OWN_PARAMETERS = COMMON + 3  # from here on those of the fit
SAMPLES, PREVIOUS, COUNTS = OWN_INTS, OWN_INTS + 1, OWN_INTS + 2  # state_i
PERIODS = COUNTS + SLOTS  # period of each sample, from the first one
INTS = PERIODS + SLOTS

# The paper's "n = max{1, 2, 3, …} such that" can mean the longest window up to the first that fails (`first`, what
# every public code does) or the longest that passes at all (`global`).
STOPS = ("first", "global")
STOP_FIRST = STOPS.index("first")
# With whole counts a residual of exactly the band is frequent, and rounding must not decide it.
ROUNDING_MARGIN = 1e-9

SETTINGS: tuple[Setting | Choice, ...] = (
    # Not half a count, the rounding error: the chord through two rounded samples can miss a true ramp by a whole one.
    Setting("band", 1.0, 0.1, 1e6, "counts", "largest distance of a sample from the line"),
    Setting("window_limit", 16.0, 1.0, LONGEST, "velocity periods", "longest window"),
    Choice(
        "stop", "first", STOPS, "window: the last before the first that fails, or the longest that passes"
    ),
)


@kernel("i8(i8, i8, i8[::1])", inline=True, no_refcount=True)
def remember(count: int, elapsed_ticks: int, state_i: Ints) -> int:
    """Add a sample (count, elapsed periods) to the ring buffer of the estimator; return its index in the buffer."""
    slot = state_i[SAMPLES] & MASK
    if state_i[SAMPLES] > 0:
        last = (slot - 1) & MASK
        moved = count_difference(count, state_i[PREVIOUS])
        state_i[COUNTS + slot] = state_i[COUNTS + last] + moved
        # Periods and not samples, so that lost ones bend nothing and the window's limit bounds the delay.
        state_i[PERIODS + slot] = state_i[PERIODS + last] + elapsed_ticks
    state_i[PREVIOUS] = count
    state_i[SAMPLES] += 1
    return int(slot)


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return three parameters: noise band (counts, plus a margin for rounding), longest window (periods), stop rule.

    The stop rule is the index of the setting ``stop`` in `STOPS`: when the search for a longer window ends.
    """
    limit = settings["window_limit"]
    if limit != round(limit):
        raise ConfigError(
            f"estimator foaw: window_limit = {limit:g} is not a whole number of velocity periods",
            remedy=f"choose {int(limit)} or {int(limit) + 1}",
        )
    return [settings["band"] * (1.0 + ROUNDING_MARGIN), limit, float(STOPS.index(settings["stop"]))]
