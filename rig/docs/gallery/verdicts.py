"""
Stable, limit cycle, unstable
=============================

Three walls of one rig, from contact to release, each with the verdict of its recording.
"""

import matplotlib.pyplot as plt

import rig

WALLS = ((200.0, 0.5), (200.0, 1.0), (1500.0, 0.5))

figure, axes = plt.subplots(2, 3, figsize=(11, 4.6), sharex=True)
for column, (stiffness, damping) in zip(axes.T, WALLS, strict=True):
    result = rig.hit("koul-rigid", stiffness=stiffness, damping=damping, effort=0.5, duration_s=0.6)
    recording = result.recording
    shown = recording.column("phase") == 3
    time_s = recording.time_s[shown] - recording.time_s[shown][0]
    column[0].plot(time_s, 1e3 * recording.column("penetration")[shown], linewidth=0.8)
    column[1].plot(time_s, recording.column("effort_sent")[shown], linewidth=0.5)
    column[0].set_title(f"K = {stiffness:g}, B = {damping:g}: {result.verdict.kind}", fontsize=10)
    column[1].set_xlabel("time (s)")
axes[0, 0].set_ylabel("depth (mrad)")
axes[1, 0].set_ylabel("effort (N·m)")
figure.tight_layout()
