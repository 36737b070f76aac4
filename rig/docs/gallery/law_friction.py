"""
Law: friction
=============

The handle drags like a block on a table: it holds until the hand pushes harder than Coulomb friction, then slides. A
presliding model (Hayward and Armstrong 2000): a spring K to an anchor, which slips at the Coulomb force; and damping B.
"""

import matplotlib.pyplot as plt
import numpy as np

import rig


@rig.law(parameters={"coulomb": 0.06}, memory=("begun", "anchor"), everywhere=True)
def friction(penetration: float, velocity: float, p: rig.Parameters, memory: rig.Memory) -> float:
    """Coulomb friction behind a spring, and viscous friction."""
    if memory.begun == 0.0:
        memory.begun, memory.anchor = 1.0, penetration
    longest = p.coulomb / p.stiffness
    stretch = min(max(penetration - memory.anchor, -longest), longest)
    memory.anchor = penetration - stretch
    return p.stiffness * stretch + p.damping * velocity


sway = {"operator.press": 2.0, "operator.press_modulation": 0.95}  # N; twice a second
result = rig.hit("hapkit", law=friction, stiffness=5.0, operator="normal", duration_s=2.0, changes=sway)
trial = result.recording.rows[result.recording.column("phase") == 3]
plt.plot(trial["penetration"], trial["effort_wall"], linewidth=0.8)
plt.gca().set(xlabel="position (rad)", ylabel="reaction (N·m)")

position, reaction = trial["penetration"][-500:], trial["effort_wall"][-500:]  # of one cycle, 0.5 s
dissipated = reaction[:-1] @ np.diff(position)
assert dissipated > 2 * 0.06 * (np.ptp(position) - 2 * 0.06 / 5.0)  # area of the loop without viscosity
