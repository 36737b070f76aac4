"""A wall law of your own: its parameters name what it needs, and the function is compiled when it is defined.

Return the reaction of the wall (N·m, or N for a linear rig), positive out of the wall. It runs in every tick.
"""

import rig
from rig.testing import check_law


@rig.law(parameters={"depth": rig.Parameter(default=0.005, minimum=1e-4, maximum=0.1, unit="rad")})
def hardening(penetration: float, velocity: float, p: rig.Parameters) -> float:
    """Wall whose stiffness doubles at `depth` inside it."""
    stiffness = p.stiffness * (1.0 + penetration / p.depth)
    return max(0.0, stiffness * penetration + p.damping * velocity)


check_law(hardening)  # finite, bounded, repeatable, nothing outside of the wall
result = rig.hit("koul-compliant", law=hardening, stiffness=100.0, damping=0.5, duration_s=0.6)
print(result.verdict.kind, result.verdict.peak_penetration)
