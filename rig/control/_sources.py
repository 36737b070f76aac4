"""Efforts that are not the wall: the homing servo and the constant push of an automated trial.

Homing moves a set point towards the start at limited speed and follows it with a soft, clipped servo, so
that whatever is in the way meets at most `home_effort`.
"""

from __future__ import annotations

from rig.realtime.kernel import kernel


@kernel("f8(f8, f8, f8)", inline=True)
def approach(setpoint: float, target: float, step: float) -> float:
    """Move a set point towards its target by at most one step."""
    if setpoint < target:
        return min(setpoint + step, target)
    return max(setpoint - step, target)


@kernel("f8(f8, f8, f8, f8, f8)", inline=True)
def servo(error: float, velocity: float, stiffness: float, damping: float, limit: float) -> float:
    """Return the spring to the set point, damping to rest, clipped to ±limit (N·m or N)."""
    effort = stiffness * error - damping * velocity
    return min(max(effort, -limit), limit)
