"""Measure one hit from its first contact on: how deep, how often, how long, in encoder counts.

`compare` calls it. Counts because Koul et al. plot them (Fig. 7).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from rig.control.estimators import Floats

# Less is a toggling count, not a peak.
LEAST_SWING = 2.0  # counts that the handle must turn back by, for a peak to be one
SWING_SHARE = 0.1  # and of the depth of the first peak below the rest
REST_SHARE = 0.25  # of the trace, whose end is the rest position


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpactNumbers:
    """Numbers of one hit, or the mean of several.

    Attributes
    ----------
    impact_velocity
        True velocity of the sensed side at the first sample inside (rad/s or m/s), positive inwards.
    peak
        Deepest penetration (counts).
    second_peak
        Deepest penetration after the handle has turned back from the peak and come again (counts); None if it did not.
    rest
        Mean penetration over the end of the trace (counts).
    bounces
        How often the handle left the wall and came back.
    decay
        (second_peak − rest) / (peak − rest), a rest outside the wall taken as its surface: 0 without a second
        oscillation, 1 and more for a wall that does not damp.
    settling_s
        Time after which the penetration stays within `SWING_SHARE` of the first oscillation around the rest, one count
        at least (s); None if it never does.
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
    """Traces of one hit, one value a tick from the first sample inside on, each of shape (n,).

    Attributes
    ----------
    offset
        Where position zero lies in its encoder cell (count).
    time_s
        From the first sample inside (s).
    counts
        Penetration as measured (counts); negative outside.
    penetration, penetration_true
        The same in rad or m, and that of the handle.
    velocity, velocity_true
        Into the wall (rad/s or m/s): what the law saw, held or extrapolated, and that of the sensed side.
    complete
        False when the guard ended the run.
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
    """Return numbers of a trace that begins at the first sample inside; `counts` is the penetration, shape (n,)."""
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
    """Return the deepest value after the peak, once the handle has moved back by `swing` and then in by as much."""
    after = counts[int(np.argmax(counts)) :]
    returned = np.flatnonzero(after <= after[0] - swing)
    if not len(returned):
        return None
    later = after[returned[0] :]
    coming = np.flatnonzero(later >= np.minimum.accumulate(later) + swing)
    return float(later[coming[0] :].max()) if len(coming) else None


def mean(numbers: Iterable[ImpactNumbers]) -> ImpactNumbers:
    """Mean of each number over several hits: the second peak over those that have one, the settling if all settled."""
    rows = [asdict(each) for each in numbers]
    values: dict[str, Any] = {}
    for name in rows[0]:
        known = [value for row in rows if (value := row[name]) is not None]
        values[name] = float(np.mean(known)) if known else None
    if any(row["settling_s"] is None for row in rows):
        values["settling_s"] = None
    return ImpactNumbers(**values)
