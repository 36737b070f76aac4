"""The last word before an effort leaves: finite, within its limit, within its slew, in whole current quanta.

Three small functions, called once each and in this order by `rig.control.step`. The device repeats the limits on
its own; this one is the early warning, and the only place of the host that clips.
"""

from __future__ import annotations

import math

import numpy as np

from rig.realtime.kernel import kernel


@kernel("f8(f8, f8)", inline=True)
def limited(effort: float, limit: float) -> float:
    """Clip an effort to ±limit; a value that is not finite gives zero (the caller flags it)."""
    if not math.isfinite(effort):
        return 0.0
    return min(max(effort, -limit), limit)


@kernel("f8(f8, f8, f8)", inline=True)
def slewed(effort: float, previous: float, step: float) -> float:
    """Keep an effort within ±step of the previous one."""
    return min(max(effort, previous - step), previous + step)


@kernel("f8(f8, f8)", inline=True)
def current_quanta(effort: float, effort_quantum: float) -> float:
    """Current command for an effort, in whole quanta of the wire: nearest, halves towards +∞, within i16."""
    return float(np.floor(min(max(effort / effort_quantum + 0.5, -32767.0), 32767.0)))
