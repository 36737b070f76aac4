"""
Delay and noise of velocity estimators
======================================

A motion of 5 Hz to 25 Hz on a coarse encoder: each point is one setting of an estimator. Its delay is that of the best
match with the truth, its noise the remaining error.
"""

import matplotlib.pyplot as plt
import numpy as np

import rig

RATE, RESOLUTION = 20_000, 2e-5  # Hz, m
time_s = np.arange(20_000) / RATE
phase = 2 * np.pi * (5 * time_s + 10 * time_s**2)
speed = 1e-3 * 2 * np.pi * (5 + 20 * time_s) * np.cos(phase)
counts = rig.quantise(1e-3 * np.sin(phase), RESOLUTION)
SWEEPS = {
    "fdm-butterworth": ("cutoff_hz", (100, 150, 250, 400, 700)),
    "kalman": ("bandwidth_hz", (100, 150, 250, 400, 700)),
}

figure, axes = plt.subplots(figsize=(7, 4))
for name, (setting, values) in SWEEPS.items():
    points = []
    for value in values:
        velocity = rig.estimate(name, counts, 1 / RATE, resolution=RESOLUTION, **{setting: float(value)})
        errors = [np.std(velocity[2000:] - speed[2000 - late : len(speed) - late]) for late in range(100)]
        points.append((1e3 * int(np.argmin(errors)) / RATE, 1e3 * min(errors)))
    axes.plot(*zip(*points, strict=True), "o-", label=f"{name}, {setting} {values[0]} to {values[-1]}")
axes.set(xlabel="delay (ms)", ylabel="error without it (mm/s rms)", ylim=(0, None))
axes.legend()
figure.tight_layout()
