"""
Law: mass on a spring
=====================

Something hangs on the handle and swings on after the hand has stopped. The law stores place and speed of the mass. Its
step is implicit (backward Euler): stable for any number of lost samples, and it only takes energy.
"""

import matplotlib.pyplot as plt
import numpy as np

import rig


@rig.law(parameters={"mass": 1e-3}, memory=("begun", "place", "speed"), everywhere=True)
def mass(penetration: float, elapsed_s: float, p: rig.Parameters, memory: rig.Memory) -> float:
    """Inertia on a spring K."""
    if memory.begun == 0.0:
        memory.begun, memory.place = 1.0, penetration
    impulse = elapsed_s * p.stiffness * (penetration - memory.place)
    memory.speed = (p.mass * memory.speed + impulse) / (p.mass + elapsed_s**2 * p.stiffness)
    memory.place += elapsed_s * memory.speed
    return p.stiffness * (penetration - memory.place)


reach = {"trial.start": -0.15, "operator.depth": 0.006, "operator.reach_s": 0.2, "operator.press": 0.0}
result = rig.hit("hapkit", law=mass, stiffness=2.0, operator="normal", duration_s=1.7, changes=reach)
trial = result.recording.rows[result.recording.column("phase") == 3]
plt.plot(1e-3 * np.arange(len(trial)), trial["effort_wall"])
plt.gca().set(xlabel="time (s)", ylabel="reaction (N·m)")

spectrum = np.abs(np.fft.rfft(trial["effort_wall"][-1000:], 10_000))  # in steps of 0.1 Hz
assert abs(0.1 * spectrum.argmax() - np.sqrt(2.0 / 1e-3) / (2 * np.pi)) < 0.2  # Hz: of the mass alone
