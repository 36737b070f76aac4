"""
Law: grating
============

The handle catches in grooves, one every `pitch`, like a nail on a comb; a fast stroke feels like a vibration. The force
is proportional to the slope of a sinusoidal surface (Minsky et al. 1990); K is its stiffness at the bottom of a groove.
"""

from math import pi, sin

import matplotlib.pyplot as plt
import numpy as np

import rig


@rig.law(parameters={"pitch": 0.04}, everywhere=True)
def grating(penetration: float, p: rig.Parameters) -> float:
    """Sine of the position."""
    wave_number = 2.0 * pi / p.pitch
    return p.stiffness / wave_number * sin(wave_number * penetration)


stroke = {"trial.start": -0.04, "operator.depth": 0.03, "operator.reach_s": 1.0, "operator.press": 0.0}
result = rig.hit("hapkit", law=grating, stiffness=8.0, operator="relaxed", duration_s=1.7, changes=stroke)
trial = result.recording.rows[result.recording.column("phase") == 3]
figure, axes = plt.subplots(2, sharex=True)
axes[0].plot(trial["penetration"], trial["effort_wall"])
axes[0].set(ylabel="reaction (N·m)")
axes[1].plot(trial["penetration"], trial["velocity"])
axes[1].set(xlabel="position (rad)", ylabel="velocity (rad/s)")

grid = np.linspace(0.0, 0.24, 480, endpoint=False)  # six grooves
speed = np.interp(grid, np.maximum.accumulate(trial["penetration"]), trial["velocity"])
assert np.argmax(np.abs(np.fft.rfft(speed - speed.mean()))) == 6  # the hand is slowed once in each
