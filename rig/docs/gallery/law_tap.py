"""
Law: hard surface with a contact transient
==========================================

The surface feels like wood though its spring is soft: a contact starts a short vibration, in proportion to the speed v
of arrival (event-based haptics, Kuchenbecker et al. 2006). The force is K·x + gain·v·exp(-t/decay)·sin(2πft). Hard is
what has a fast first rise of force, divided by the speed (rate-hardness, Lawrence et al. 2000).
"""

from math import exp, pi, sin

import matplotlib.pyplot as plt

import rig


@rig.law(parameters={"gain": 0.5, "hz": 100.0, "decay_s": 0.008}, memory=("v", "t"), everywhere=True)
def tap(
    penetration: float, velocity: float, elapsed_s: float, p: rig.Parameters, memory: rig.Memory
) -> float:
    """Spring, and a decaying vibration from each contact on."""
    if penetration <= 0.0:
        memory.v, memory.t = max(velocity, 0.0), 0.0
        return 0.0
    transient = p.gain * memory.v * exp(-memory.t / p.decay_s) * sin(2.0 * pi * p.hz * memory.t)
    memory.t += elapsed_s
    return max(0.0, p.stiffness * penetration + transient)


hardness = []  # N·m/rad
for gain in (0.0, 0.5):
    law = tap.with_parameters(gain=gain)
    result = rig.hit("koul-rigid", law=law, stiffness=100.0, damping=0.0, duration_s=0.6)
    contact = (result.recording.column("penetration") > 0.0).argmax()
    time_s, rows = result.recording.time_s[contact:][:250], result.recording.rows[contact:][:250]
    plt.plot(1e3 * (time_s - time_s[0]), rows["effort_wall"], label=f"gain = {gain:g} N·m·s/rad")
    hardness.append((rows["effort_wall"][10] - rows["effort_wall"][0]) / 5e-4 / rows["velocity"][0])
plt.gca().set(xlabel="time from contact (ms)", ylabel="reaction (N·m)")
plt.legend()
assert hardness[1] > 3 * hardness[0]
