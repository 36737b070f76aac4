"""
Force over penetration
======================

A wall is a line in this plane; damping makes it a loop. A simulated hand enters, presses and leaves.
"""

import matplotlib.pyplot as plt

import rig

figure, axes = plt.subplots(figsize=(6, 4))
for damping in (0.0, 0.3):
    recording = rig.hit("koul-compliant", stiffness=200.0, damping=damping, operator="relaxed").recording
    inside = recording.column("penetration") > 0.0
    axes.plot(
        1e3 * recording.column("penetration")[inside],
        recording.column("effort_wall")[inside],
        linewidth=0.7,
        label=f"B = {damping:g} N·m·s/rad",
    )
axes.set(xlabel="depth (mrad)", ylabel="reaction of the wall (N·m)")
axes.legend()
figure.tight_layout()
