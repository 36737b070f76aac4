"""
Law: bump and valley
====================

A bump holds the hand back and a valley draws it in, although the handle moves on a line: the force alone is felt as a
shape (Robles-De-La-Torre and Hayward 2001). It is the slope of a potential, ±K·width²·exp(-(x/width)²/2).
"""

from math import exp

import matplotlib.pyplot as plt

import rig


@rig.law(parameters={"width": 0.03, "sign": 1.0}, everywhere=True)
def bump(penetration: float, p: rig.Parameters) -> float:
    """Slope of a Gaussian: a bump with sign = 1, a valley with -1."""
    return -p.sign * p.stiffness * penetration * exp(-0.5 * (penetration / p.width) ** 2)


speeds = []
reach = {"trial.start": -0.15, "operator.depth": 0.012, "operator.press": 0.0}
for name, sign in {"valley": -1.0, "flat": 0.0, "bump": 1.0}.items():
    law = bump.with_parameters(sign=sign)
    result = rig.hit("hapkit", law=law, stiffness=3.0, operator="normal", duration_s=1.0, changes=reach)
    trial = result.recording.rows[result.recording.column("phase") == 3]
    plt.plot(trial["penetration"], trial["effort_wall"], label=name)
    speeds.append(trial["velocity"][(trial["penetration"] > 0.0).argmax()])
plt.gca().set(xlabel="position (rad)", ylabel="reaction (N·m)")
plt.legend()

assert speeds[0] > speeds[1] > speeds[2] > 0.0  # at the middle: the handle pays the potential
