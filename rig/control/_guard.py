"""Last check of an effort before it is sent: finite, within its limit, within its slew, in whole current quanta.

`rig.control.step` calls each function once and in this order. The device repeats the limits; nothing else on the host
may clip.
"""

from __future__ import annotations

import math

import numpy as np

from rig.realtime.kernel import kernel


@kernel("f8(f8, f8)", inline=True)
def clip_effort(effort: float, limit: float) -> float:
    """Clip an effort to ±limit; a value that is not finite gives zero (the caller flags it)."""
    # min and max would turn a NaN into a limit, which is full effort.
    if not math.isfinite(effort):
        return 0.0
    return min(max(effort, -limit), limit)


@kernel("f8(f8, f8, f8)", inline=True)
def limit_slew(effort: float, previous: float, step: float) -> float:
    """Keep an effort within ±step of the previous one."""
    return min(max(effort, previous - step), previous + step)


@kernel("f8(f8, f8)", inline=True)
def current_quanta(effort: float, effort_quantum: float) -> float:
    """Return the current command for an effort, in whole quanta of the wire: nearest, halves towards +∞, within i16."""
    # floor(x + ½) and not round, which takes halves to even: firmware/law and old recordings have halves towards +∞.
    return float(np.floor(min(max(effort / effort_quantum + 0.5, -32767.0), 32767.0)))
