"""
Velocity of one motion at two rates
===================================

A slow motion measured by an encoder of 0.157 mrad a count: its difference at 20 kHz and at 2 kHz.
"""

import matplotlib.pyplot as plt
import numpy as np

import rig

RESOLUTION = 1.57e-4  # rad: 1000 lines, four edges each, a ratio of 10

figure, axes = plt.subplots(1, 2, figsize=(10, 3.4), sharey=True)
for ax, rate in zip(axes, (20_000, 2_000), strict=True):
    time_s = np.arange(0.0, 0.5, 1.0 / rate)
    position = 0.1 * (1.0 - np.cos(2 * np.pi * 2 * time_s))
    velocity = rig.estimate("fdm", rig.quantise(position, RESOLUTION), 1.0 / rate, resolution=RESOLUTION)
    ax.plot(time_s, velocity, linewidth=0.5, label="difference of counts")
    ax.plot(time_s, 0.1 * 2 * np.pi * 2 * np.sin(2 * np.pi * 2 * time_s), color="black", label="truth")
    ax.set(title=f"{rate // 1000} kHz", xlabel="time (s)")
axes[0].set_ylabel("velocity (rad/s)")
axes[0].legend(loc="lower left")
figure.tight_layout()
