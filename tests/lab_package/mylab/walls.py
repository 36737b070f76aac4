"""A wall with a click in it."""

import math

import rig


@rig.law(
    parameters={
        "period": rig.Parameter(default=0.002, minimum=1e-4, unit="rad", meaning="from click to click"),
        "share": rig.Parameter(default=0.3, minimum=0.0, maximum=1.0, unit="1", meaning="of the spring"),
    },
    memory=("clicks", "inside"),
)
def detent(penetration: float, velocity: float, memory: rig.Memory, p: rig.Parameters) -> float:
    """A spring whose force falls with each click that is passed, and that counts them."""
    cell = math.floor(penetration / p.period)
    if cell > memory.inside:
        memory.clicks += 1.0
    memory.inside = cell
    depth = penetration - p.share * cell * p.period
    return max(0.0, p.stiffness * depth + p.damping * velocity)
