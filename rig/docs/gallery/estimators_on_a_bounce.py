"""
Velocity estimators on a bounce
===============================

The handle arrives, is thrown back within some milliseconds, and leaves. A coarse encoder, a velocity rate of 2 kHz.
"""

import matplotlib.pyplot as plt
import numpy as np

import rig

RATE, RESOLUTION, SPEED, CONTACT_S = 2_000, 2e-5, 0.1, 0.015
time_s = np.arange(-0.03, 0.05, 1 / RATE)
inside = np.clip(time_s, 0.0, CONTACT_S)
truth = np.where(time_s < 0.0, SPEED, SPEED * np.cos(np.pi * inside / CONTACT_S))
position = np.concatenate([[0.0], np.cumsum(0.5 * (truth[1:] + truth[:-1])) / RATE])
counts = rig.quantise(position, RESOLUTION)

figure, axes = plt.subplots(figsize=(8, 4))
axes.plot(1e3 * time_s, truth, color="black", label="truth")
for name, settings in {
    "fdm": {},
    "fdm-butterworth": {"cutoff_hz": 250.0},
    "foaw-best": {},
    "kalman": {"bandwidth_hz": 130.0},
}.items():
    velocity = rig.estimate(name, counts, 1 / RATE, resolution=RESOLUTION, **settings)
    axes.step(1e3 * time_s, velocity, where="post", linewidth=0.9, label=name)
axes.set(xlabel="time from contact (ms)", ylabel="velocity (m/s)")
axes.legend()
figure.tight_layout()
