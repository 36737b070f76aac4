"""Measure penetration, bounces and settling time of one hit from its first contact on, in encoder counts.

`rig.experiments.hits.compare` calls this module. The unit is the count because Koul et al. plot counts (Fig. 7).
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from rig.control.estimators import Floats

# A reversal counts as an oscillation if the handle moves back by this number of counts (a single toggling count is
# noise), and by this fraction of the first peak's depth below the rest.
LEAST_SWING, SWING_SHARE = 2.0, 0.1
# The rest position is the mean over this last fraction of the trace.
REST_SHARE = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpactNumbers:
    """A summary of one hit, or the mean of several hits' summaries.

    Attributes
    ----------
    impact_velocity
        True velocity at the encoder at the first sample inside the wall (rad/s or m/s), positive into the wall.
    peak
        Deepest penetration (counts).
    second_peak
        Deepest penetration of the next oscillation after the peak (counts); None if the handle did not turn back and
        then move inwards again.
    rest
        Mean penetration over the last quarter of the trace (counts).
    bounces
        Number of times that the handle left the wall and entered it again.
    decay
        (second_peak − rest) / (peak − rest), where a negative rest counts as 0. The decay is 0 without a second peak,
        and 1 or more if the wall does not damp.
    settling_s
        Time after which |penetration − rest| stays within 10 % of peak − rest, or within one count if one count
        is more (s); None if the handle never settles.
    """

    impact_velocity: float
    peak: float
    second_peak: float | None
    rest: float
    bounces: float
    decay: float
    settling_s: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """A simulated hit: traces of shape (n,), with one value for each tick from the first sample inside the wall on.

    Attributes
    ----------
    offset
        Distance of position zero from the lower edge of its encoder cell (counts, 0 to below 1).
    time_s
        Time since the first sample inside the wall (s).
    counts
        Measured penetration (counts); negative outside the wall.
    penetration, penetration_true
        Measured penetration, and true penetration of the handle (rad or m).
    velocity, velocity_true
        Velocity into the wall (rad/s or m/s): the estimate that the law used, and the true velocity at the encoder.
    complete
        False if the safety guard (limits on position, speed and effort) ended the run.
    """

    offset: float
    time_s: Floats = field(repr=False)
    counts: Floats = field(repr=False)
    penetration: Floats = field(repr=False)
    penetration_true: Floats = field(repr=False)
    velocity: Floats = field(repr=False)
    velocity_true: Floats = field(repr=False)
    complete: bool
    numbers: ImpactNumbers


def measure(time_s: Floats, counts: Floats, impact_velocity: float) -> ImpactNumbers:
    """Return peak, rest, bounces, decay and settling time of one hit.

    `time_s` (s) and the penetration `counts` (counts) have shape (n,) and begin at the first sample inside the wall;
    `impact_velocity` (rad/s or m/s) is copied into the result.
    """
    end = max(1, round(REST_SHARE * len(counts)))
    peak, rest = float(counts.max()), float(counts[-end:].mean())
    swing = max(LEAST_SWING, SWING_SHARE * (peak - rest))
    second, base = second_peak(counts, swing), max(rest, 0.0)
    inside = counts > 0.0
    away = np.flatnonzero(np.abs(counts - rest) > max(1.0, SWING_SHARE * (peak - rest)))
    last = int(away[-1]) + 1 if len(away) else 0
    return ImpactNumbers(
        impact_velocity=impact_velocity,
        peak=peak,
        second_peak=second,
        rest=rest,
        bounces=float(np.count_nonzero(inside[1:] & ~inside[:-1])),
        decay=0.0 if second is None else max(0.0, (second - base) / (peak - base)),
        settling_s=float(time_s[last]) if last <= len(counts) - end else None,
    )


def second_peak(counts: Floats, swing: float) -> float | None:
    """Return the deepest penetration of the next oscillation after the peak (counts); None without an oscillation.

    An oscillation counts only if the handle moved back from the peak by `swing` (counts) and then inwards by `swing`.
    """
    after = counts[int(np.argmax(counts)) :]
    returned = np.flatnonzero(after <= after[0] - swing)
    if not len(returned):
        return None
    later = after[returned[0] :]
    coming = np.flatnonzero(later >= np.minimum.accumulate(later) + swing)
    return float(later[coming[0] :].max()) if len(coming) else None


def mean(numbers: Iterable[ImpactNumbers]) -> ImpactNumbers:
    """Return the mean of each number over several hits.

    The second peak is averaged over the hits that have a second peak; the settling time is None if any hit did not
    settle.
    """
    rows = [asdict(each) for each in numbers]
    values: dict[str, Any] = {}
    for name in rows[0]:
        known = [value for row in rows if (value := row[name]) is not None]
        values[name] = float(np.mean(known)) if known else None
    if any(row["settling_s"] is None for row in rows):
        values["settling_s"] = None
    return ImpactNumbers(**values)
