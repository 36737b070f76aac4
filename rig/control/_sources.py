"""Effort of the homing servo, and the motion of its set point.

Homing moves a set point towards the start at limited speed. A soft servo, clipped to `home_effort`, follows it, so that
an obstacle is pressed with at most that effort. `rig.control.step` calls it in each tick. It must not allocate.
"""

from rig.realtime.kernel import kernel


@kernel("f8(f8, f8, f8)", inline=True)
def approach(setpoint: float, target: float, step: float) -> float:
    """Return the set point moved towards its target by at most `step` (rad or m)."""
    if setpoint < target:
        return min(setpoint + step, target)
    return max(setpoint - step, target)


@kernel("f8(f8, f8, f8, f8, f8)", inline=True)
def servo(error: float, velocity: float, stiffness: float, damping: float, limit: float) -> float:
    """Return the effort (N·m or N) of a spring (position error) and a damper (velocity), clipped to ±limit."""
    effort = stiffness * error - damping * velocity
    return min(max(effort, -limit), limit)
