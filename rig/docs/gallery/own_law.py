"""
Custom wall laws
================

Three surfaces as functions: a linear wall, a hardening one, and one that breaks through. Each is compiled and can be
used in a hit.
"""

import matplotlib.pyplot as plt
import numpy as np

import rig
from rig.testing import reactions


@rig.law(parameters={"quadratic": 5e4})
def hardening(penetration: float, p: rig.Parameters) -> float:
    """Grow harder with depth."""
    return max(0.0, p.stiffness * penetration + p.quadratic * penetration**2)


@rig.law(parameters={"depth": 5e-3}, memory=("broken",))
def breaking(penetration: float, p: rig.Parameters, memory: rig.Memory) -> float:
    """Give way for good where it was pressed too deep."""
    if penetration > p.depth:
        memory.broken = 1.0
    return max(0.0, (1.0 - 0.8 * memory.broken) * p.stiffness * penetration)


depth = 8e-3 * np.sin(np.pi * np.arange(401) / 400)
figure, axes = plt.subplots(figsize=(6, 4))
for name, law in (("linear", "spring-damper"), ("hardening", hardening), ("breaking", breaking)):
    axes.plot(1e3 * depth, np.abs(reactions(law, depth, 0.0, stiffness=300.0, damping=0.0)), label=name)
axes.set(xlabel="depth (mrad)", ylabel="reaction (N·m)")
axes.legend()
figure.tight_layout()
