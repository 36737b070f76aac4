"""A law and an estimator from plain functions, compiled once for all tests of a process."""

from functools import cache

import rig


@cache
def stiffening() -> rig.Law:
    parameter = rig.Parameter(default=1e5, minimum=0.0, maximum=1e6, unit="N·m/rad²")

    @rig.law(parameters={"quadratic": parameter})
    def stiffening(penetration: float, velocity: float, p: rig.Parameters) -> float:
        """A wall that grows harder with depth."""
        return p.stiffness * penetration + p.quadratic * penetration**2 + p.damping * velocity

    return stiffening


@cache
def blend() -> rig.Estimator:
    weight = rig.Parameter(default=0.5, minimum=0.0, maximum=1.0)

    @rig.estimator(parameters={"weight": weight}, memory=("slope",), name="mine", source="a paper")
    def blend(travel: float, elapsed_s: float, memory: rig.Memory, p: rig.Parameters) -> float:
        """Return the weighted sum of the last two slopes."""
        before, memory.slope = memory.slope, travel / elapsed_s
        return p.weight * before + (1.0 - p.weight) * memory.slope

    return blend
