"""Last steps before an effort is sent: zero if not finite, clip to its limit, limit its slew, round to current quanta.

`rig.control.step` calls each function once and in this order. The device applies its limits again; no other code on the
host may clip an effort.
"""

import math

import numpy as np

from rig.realtime.kernel import kernel


@kernel("f8(f8, f8)", inline=True)
def clip_effort(effort: float, limit: float) -> float:
    """Return the effort clipped to ±limit (N·m or N); 0 if it is not finite."""
    # min and max would turn a NaN into a limit, which is full effort.
    if not math.isfinite(effort):
        return 0.0
    return min(max(effort, -limit), limit)


@kernel("f8(f8, f8, f8)", inline=True)
def limit_slew(effort: float, previous: float, step: float) -> float:
    """Return the effort (N·m or N) moved by at most `step` from the effort of the previous tick."""
    return min(max(effort, previous - step), previous + step)


@kernel("f8(f8, f8)", inline=True)
def current_quanta(effort: float, effort_quantum: float) -> float:
    """Return the current (whole quanta, the smallest steps) for an effort (N·m or N): nearest, within ±32767."""
    # floor(x + ½) and not round, which takes halves to even: firmware/law and old recordings have halves towards +∞.
    return float(np.floor(min(max(effort / effort_quantum + 0.5, -32767.0), 32767.0)))
