"""
Velocity noise of an encoder count
==================================

The error of a plain difference while the handle moves: Δ·f/√6 for any motion that crosses counts.
"""

import matplotlib.pyplot as plt
import numpy as np

import rig

RATES = np.array([500, 1_000, 2_000, 5_000, 10_000, 20_000])
SPEED = 0.2  # m/s, and slowly more

figure, axes = plt.subplots(figsize=(7, 4))
for resolution in (1e-6, 20e-6):
    errors = []
    for rate in RATES:
        position = SPEED * np.arange(4000) / rate * (1.0 + 1e-4 * np.arange(4000))
        velocity = rig.estimate("fdm", rig.quantise(position, resolution), 1.0 / rate, resolution=resolution)
        errors.append(np.sqrt(np.mean((velocity[1:] - np.diff(position) * rate) ** 2)))
    axes.loglog(RATES, errors, "o", label=f"measured, {1e6 * resolution:g} µm a count")
    axes.loglog(RATES, resolution * RATES / np.sqrt(6), color="0.6")
axes.set(xlabel="velocity rate (Hz)", ylabel="rms error (m/s)")
axes.legend()
figure.tight_layout()
